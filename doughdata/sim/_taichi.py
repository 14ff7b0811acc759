"""The one module that imports Taichi, so that a fork of it can be swapped in one place."""

import os
import warnings
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any

from doughschemas import BadInputError, MissingPackageError

__all__ = ["check_arch", "start", "ti"]

# Taichi prints a banner on import, which would break the one JSON object of `--json`.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

try:
    with warnings.catch_warnings():  # its own, about functions of the standard library
        warnings.simplefilter("ignore", DeprecationWarning)
        # Any: Taichi's annotations are values, which a type checker cannot follow.
        ti: Any = import_module("taichi")
except ModuleNotFoundError as error:
    raise MissingPackageError("taichi", "sim") from error

_started: list[str] = []  # what this process runs on, once decided


def check_arch(arch: str) -> None:
    """Refuse what cannot be simulated on.

    Raises:
        BadInputError: an unknown name, or a GPU, for which there are no kernels.
    """
    if arch in ("cuda", "vulkan"):
        raise BadInputError(f"arch {arch!r}: scenes are simulated on the CPU; use auto or cpu")
    if arch not in ("auto", "cpu"):
        raise BadInputError(f"arch must be one of auto, cpu, cuda, vulkan; got {arch!r}")


def start(arch: str) -> None:
    """Start Taichi once per process; later calls only check the name.

    Args:
        arch: `cpu`, or `auto`, which is the CPU: scenes are spread over processes, one thread each.

    Raises:
        BadInputError: an unknown name, or a GPU, for which there are no kernels.
    """
    check_arch(arch)
    if not _started:
        with redirect_stdout(StringIO()):  # its second banner
            ti.init(
                arch=ti.cpu,
                cpu_max_num_threads=1,
                default_fp=ti.f32,
                fast_math=False,  # NaN must be seen, and results must not depend on contraction
                cfg_optimization=False,  # loses updates in 1.7.4, and doubles compile time
                offline_cache=False,  # a killed worker would leave a locked cache behind
                log_level=ti.ERROR,
            )
        _started.append("cpu")
