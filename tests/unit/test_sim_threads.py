"""Threads change the time that a run takes, and nothing else."""

import numpy as np
import pytest

from doughdata.scenes import PRESETS
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughschemas import Material, SimulationError

SPACING, DX = 0.002, 0.003125
NAMES = ("x", "v", "C", "b", "largest")


def cloud(cells: tuple[int, int, int], *, friction: float | None, threads: int) -> Solver:
    """A block on a table, or in free space, its particles in no order."""
    rng = np.random.default_rng(3)
    lattice = np.stack(np.meshgrid(*[np.arange(n) for n in cells], indexing="ij"), axis=-1)
    points = lattice.reshape(-1, 3) + 0.5 + rng.uniform(-0.2, 0.2, (lattice.size // 3, 3))
    points = rng.permutation(points - [cells[0] / 2, cells[1] / 2, 0.0]) * SPACING
    physics = Physics(
        material=Material(yield_stress=800.0),
        spacing=SPACING,
        dx=DX,
        cfl=0.5,
        density_cap=1.15,
        gravity=0.0 if friction is None else 9.81,
        low=(-0.06, -0.06, -0.06 if friction is None else 0.0),
        high=(0.06, 0.06, 0.06),
        table_friction=friction,
    )
    return Solver(points, physics, threads=threads)


def squeezed(threads: int) -> dict[str, np.ndarray]:
    """A block half crushed between the fingers, and what is left after they stopped."""
    solver = cloud((12, 10, 6), friction=0.5, threads=threads)
    sdf = finger_sdf(PRESETS["regular"])
    for opening, rate in ((0.026, -0.4), (0.012, 0.0)):
        solver.advance(
            0.035 if rate else 0.01,
            squeeze=Squeeze(
                sdf=sdf, position=(0.001, 0.0), yaw=0.3, opening=opening, rate=rate, friction=0.4
            ),
        )
    return {name: getattr(solver, name).copy() for name in NAMES}


def spun(threads: int) -> dict[str, np.ndarray]:
    """A block that flows while it spins freely."""
    solver = cloud((9, 9, 9), friction=None, threads=threads)
    solver.v[:] = np.cross([5.0, 8.0, 40.0], solver.x)
    solver.advance(0.03)
    return {name: getattr(solver, name).copy() for name in NAMES}


@pytest.mark.parametrize("run", [squeezed, spun])
def test_threads_change_no_bit(run) -> None:
    """A squeeze between fingers and a plastic spin give the same bytes on one and two threads."""
    one, two = run(1), run(2)
    moved = np.linalg.det(one["b"][:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3))
    assert np.abs(moved - 1).max() > 1e-3  # the dough was deformed at all
    for name in NAMES:
        assert one[name].tobytes() == two[name].tobytes(), name


def test_arrays_keep_the_callers_order() -> None:
    """Particles stay where the caller put them: rigid translation moves each by v t."""
    solver = cloud((8, 7, 6), friction=None, threads=1)
    before = solver.x.astype(np.float64)
    solver.v[:] = [0.02, -0.01, 0.03]
    solver.advance(0.1)
    assert np.abs(solver.x - before - np.array([0.002, -0.001, 0.003])).max() < 1e-6


@pytest.mark.parametrize("threads", [1, 2])
def test_the_broken_particle_is_the_callers(threads: int) -> None:
    """A failure on any number of threads names the place of the particle that broke the limit."""
    solver = cloud((8, 8, 8), friction=None, threads=threads)
    lone = int(np.argmax(solver.x.sum(axis=1)))
    solver.v[lone] = np.nan
    with pytest.raises(SimulationError, match="not a number") as caught:
        solver.advance(0.01)
    place = [float(part) for part in str(caught.value).split("(")[1].split(")")[0].split(",")]
    assert np.abs(place - solver.x[lone]).max() < 3 * DX + 0.001  # its neighbours break too


@pytest.mark.parametrize(("count", "threads"), [(1, 1), (3, 2)])
def test_fewer_particles_than_slices(count: int, threads: int) -> None:
    """Free fall of a few particles is v = g t, although some slices are empty."""
    full = cloud((4, 4, 4), friction=0.5, threads=1)
    start = full.x[:count] + np.array([0.0, 0.0, 0.02], np.float32)
    solver = Solver(start.astype(np.float64), full.physics, threads=threads)
    solver.advance(0.02)
    assert solver.v[:, 2] == pytest.approx(-9.81 * 0.02, rel=1e-3)
