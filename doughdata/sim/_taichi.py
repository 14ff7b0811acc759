"""The one module that imports Taichi, so that a fork of it can be swapped in one place."""

import os
import warnings
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any

from doughdata.sim.kernel_cache import kernel_cache
from doughschemas import BadInputError, MissingPackageError

__all__ = ["Bound", "check_arch", "gpu_present", "start", "ti"]

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
    cache = kernel_cache(".".join(map(str, ti.__version__)))
    with redirect_stdout(StringIO()):  # its second banner
        ti.init(
            arch=getattr(ti, wanted[0]),
            cpu_max_num_threads=threads,
            default_fp=ti.f32,
            fast_math=False,  # NaN must be seen, and results must not depend on contraction
            cfg_optimization=False,  # loses updates in 1.7.4, and doubles compile time
            **({"offline_cache_file_path": str(cache)} if cache else {"offline_cache": False}),
            log_level=ti.ERROR,
        )
    _started[:] = [wanted]


def gpu_present(arch: str) -> bool:
    """Whether this machine can run `cuda` or `vulkan`."""
    ti.set_logging_level(ti.ERROR)  # its own lines about a missing driver
    return bool(import_module("taichi.lang.misc").is_arch_supported(getattr(ti, arch)))


class Bound:
    """A kernel with its arguments bound once: a call costs a launch, and no conversions.

    With twenty arguments the conversions take 0.6 ms, as long as a substep of 10,000 particles on
    two threads. Taichi has no such call (1.7.4), so the prepared launch is taken from its program.
    Arrays are used where they are: what a caller writes into them between calls is seen.
    """

    def __init__(self, kernel: Any, *arguments: Any) -> None:
        runtime = import_module("taichi.lang.impl").get_runtime()
        runtime.materialize()
        primal, program = kernel._primal, runtime.prog
        key = primal.ensure_compiled(*arguments)
        recorder = _Recorder(program)
        runtime.prog = recorder
        try:
            primal.launch_kernel(primal.compiled_kernels[key], *arguments)
        finally:
            runtime.prog = program
        self._launch, self._prepared = program.launch_kernel, recorder.prepared
        self._alive = arguments  # the launch holds their addresses

    def __call__(self) -> None:
        self._launch(*self._prepared)


class _Recorder:
    """Stands in for Taichi's program: compiles, and keeps a launch instead of making it."""

    def __init__(self, program: Any) -> None:
        self._program = program
        self.prepared: tuple[Any, ...] = ()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._program, name)

    def launch_kernel(self, *prepared: Any) -> None:
        self.prepared = prepared
