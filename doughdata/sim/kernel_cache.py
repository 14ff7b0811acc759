"""Compiled kernels are kept between processes: a command starts in half the time.

They lie in `~/.cache/doughdata` (or `$XDG_CACHE_HOME/doughdata`); `DOUGHDATA_KERNEL_CACHE` names
another folder, and `off` compiles anew in every process. Files that are damaged or of another
Taichi are compiled again.
"""

import os
import time
from pathlib import Path

__all__ = ["VARIABLE", "kernel_cache"]

VARIABLE = "DOUGHDATA_KERNEL_CACHE"
LOCK = "ticache.lock"  # Taichi's, held for milliseconds
STALE = 60.0  # [s]; an older lock was left by a killed process


def kernel_cache(version: str) -> Path | None:
    """The folder for one version of Taichi; None where nothing can be kept."""
    named = os.environ.get(VARIABLE, "")
    if named.lower() == "off":
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "doughdata"
    folder = (Path(named).expanduser() if named else base) / f"taichi-{version}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _unlock(folder / LOCK)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _unlock(lock: Path) -> None:
    """Take away a lock that nobody holds any more: with it, nothing would be read or kept."""
    try:
        if time.time() - lock.stat().st_mtime > STALE:
            lock.unlink(missing_ok=True)
    except FileNotFoundError:
        return
