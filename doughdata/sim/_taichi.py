"""The one module that imports Taichi, so that a fork of it can be swapped in one place."""

import os
import warnings
from contextlib import redirect_stdout
from io import StringIO

from doughschemas import BadInputError, MissingPackageError

# Taichi prints a banner on import, which would break the one JSON object of `--json`.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

try:
    with warnings.catch_warnings():  # its own, about functions of the standard library
        warnings.simplefilter("ignore", DeprecationWarning)
        import taichi as ti
except ModuleNotFoundError as error:
    raise MissingPackageError("taichi", "sim") from error

__all__ = ["start", "ti"]

_started: list[str] = []  # what this process runs on, once decided


def start(arch: str) -> None:
    """Start Taichi once per process; later calls only check that they ask for the same.

    Args:
        arch: `auto` (CUDA where present, else the CPU), `cpu`, `cuda` or `vulkan`.

    Raises:
        BadInputError: an unknown name, no such device, or Taichi already runs on another.
    """
    known = {"auto": None, "cpu": ti.cpu, "cuda": ti.cuda, "vulkan": ti.vulkan}
    if arch not in known:
        raise BadInputError(f"arch must be one of {', '.join(known)}; got {arch!r}")
    wanted = _present() if arch == "auto" else arch
    if _started and _started[0] != wanted:
        raise BadInputError(
            f"Taichi runs on {_started[0]} in this process; use a new process for {wanted}"
        )
    if not _started:
        with redirect_stdout(StringIO()):  # its second banner
            ti.init(
                arch=known[wanted],
                cpu_max_num_threads=1,  # scenes are spread over processes instead
                default_fp=ti.f32,
                fast_math=False,  # NaN must be seen, and results must not depend on contraction
                cfg_optimization=False,  # loses updates in 1.7.4, and doubles compile time
                offline_cache=False,  # a killed worker would leave a locked cache behind
                log_level=ti.ERROR,
            )
        _started.append(wanted)


def _present() -> str:
    return "cuda" if ti.lang.misc.is_arch_supported(ti.cuda) else "cpu"
