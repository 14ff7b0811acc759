"""Kernels kept between processes: the same bytes, whatever state their folder is in."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from doughdata.sim.kernel_cache import LOCK, VARIABLE, kernel_cache

FALL = """
import numpy as np
from hashlib import sha256
from doughdata.sim.solver import Physics, Solver
from doughschemas import Material
x = np.stack(np.meshgrid(*[np.arange(6) * 0.002] * 3), axis=-1).reshape(-1, 3) + 0.02
physics = Physics(
    material=Material(), spacing=0.002, dx=0.004, cfl=0.4, density_cap=1.0, gravity=-9.81,
    low=(0.0, 0.0, 0.0), high=(0.06, 0.06, 0.06), table_friction=0.5,
)
solver = Solver(x, physics)
solver.advance(0.01)
print(sha256(solver.positions.tobytes()).hexdigest())
"""


def fall(cache: Path | str, **more: str) -> str:
    """Digest of a falling cube, from a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", FALL],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, VARIABLE: str(cache), **more},
    )
    assert done.stderr == ""
    return done.stdout


@pytest.mark.slow
def test_kept_kernels_give_the_same_bytes(tmp_path: Path) -> None:
    """Compiled, kept, damaged and locked: one result, and no word on stderr."""
    compiled = fall("off")
    assert fall(tmp_path) == compiled
    kept = sorted(tmp_path.rglob("*.tic"))
    assert kept
    assert fall(tmp_path) == compiled
    for file in kept:
        file.write_bytes(file.read_bytes()[:-100])
    assert fall(tmp_path) == compiled
    (kept[0].parent / LOCK).touch()  # held by another process: nothing is read, nothing breaks
    assert fall(tmp_path) == compiled


def test_a_lock_that_a_killed_process_left_is_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fresh lock stays, since its holder is at work; an old one goes."""
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    folder = kernel_cache("1")
    assert folder is not None
    lock = folder / LOCK
    lock.touch()
    assert kernel_cache("1") == folder
    assert lock.exists()
    os.utime(lock, (time.time() - 3600,) * 2)
    assert kernel_cache("1") == folder
    assert not lock.exists()


def test_without_a_place_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file where the folder should be, or `off`: every process compiles."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    assert kernel_cache("1") is None
    monkeypatch.setenv(VARIABLE, "off")
    assert kernel_cache("1") is None


def test_the_folder_is_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One folder a version of Taichi, below the cache that the desktop names."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernel_cache("1.7.4") == tmp_path / "doughdata" / "taichi-1.7.4"
