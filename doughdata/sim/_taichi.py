"""The one module that imports Taichi, so that a fork of it can be swapped in one place."""

import os
import warnings
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any

from doughschemas import BadInputError, MissingPackageError

__all__ = ["check_arch", "gpu_present", "start", "ti"]

# Taichi prints a banner on import, which would break the one JSON object of `--json`.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

try:
    with warnings.catch_warnings():  # its own, about functions of the standard library
        warnings.simplefilter("ignore", DeprecationWarning)
        # Any: Taichi's annotations are values, which a type checker cannot follow.
        ti: Any = import_module("taichi")
except ModuleNotFoundError as error:
    raise MissingPackageError("taichi", "sim") from error

ARCHS = ("auto", "cpu", "cuda", "vulkan")
_started: list[tuple[str, int]] = []  # what this process runs on: arch and threads


def check_arch(arch: str) -> None:
    """Refuse what this machine cannot simulate on.

    Raises:
        BadInputError: an unknown name, or a GPU that is not there.
    """
    if arch not in ARCHS:
        raise BadInputError(f"arch must be one of {', '.join(ARCHS)}; got {arch!r}")
    if arch in ("cuda", "vulkan") and not gpu_present(arch):
        raise BadInputError(f"arch {arch!r}: no such GPU or driver here; use auto or cpu")


def start(arch: str, *, threads: int = 1) -> None:
    """Start Taichi for an arch; started again, and kernels compiled again, only when it changes.

    Args:
        arch: `cpu`, `cuda`, `vulkan`, or `auto`, which is the CPU: scenes are spread over
            processes.
        threads: of the CPU.

    Raises:
        BadInputError: an unknown name, or a GPU that is not there.
    """
    check_arch(arch)
    wanted = ("cpu" if arch == "auto" else arch, threads)
    if _started == [wanted]:
        return
    with redirect_stdout(StringIO()):  # its second banner
        ti.init(
            arch=getattr(ti, wanted[0]),
            cpu_max_num_threads=threads,
            default_fp=ti.f32,
            fast_math=False,  # NaN must be seen, and results must not depend on contraction
            cfg_optimization=False,  # loses updates in 1.7.4, and doubles compile time
            offline_cache=False,  # a killed worker would leave a locked cache behind
            log_level=ti.ERROR,
        )
    _started[:] = [wanted]


def gpu_present(arch: str) -> bool:
    """Whether this machine can run `cuda` or `vulkan`."""
    ti.set_logging_level(ti.ERROR)  # its own lines about a missing driver
    return bool(import_module("taichi.lang.misc").is_arch_supported(getattr(ti, arch)))
