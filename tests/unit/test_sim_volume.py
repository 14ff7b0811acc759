"""Volume over whole scenes: what the material believes (det b) and what its particles fill."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from doughdata.scenes.doughnut import Doughnut
from doughdata.scenes.rolls import Rolls
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim import mpm
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughschemas import Material, Particles, Scene, Tool

SEED, RADIUS, NODES = 7, 1.5, 3  # RADIUS of the closing in spacings, NODES per spacing
SETTLE = 0.15  # [s] without fingers, in which elastic strain is given back
DX = 0.003125
DEFAULT = mpm.MpmConfig(arch="cpu", frames=11)
PLATES = Tool(name="plates", depth=0.010, width=0.060, height=0.060)


class WatchedSolver(Solver):
    """The solver itself, which can be asked for after a run."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        WatchedSolver.latest = self
        self.first: float | None = None

    @property
    def positions(self) -> np.ndarray:
        """Copy of the positions; the first call is the first key frame."""
        if self.first is None:
            self.first = mean_volume(self)
        return self.x.copy()


def mean_volume(solver: Solver) -> float:
    """Mean of J = sqrt(det b), the volume ratio that the material believes."""
    b = solver.b.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    return float(np.sqrt(np.linalg.det(b)).mean())


def closed_volume(positions: np.ndarray, spacing: float) -> float:
    """Volume [m3] of the balls' union, inflated to RADIUS and deflated but for half a spacing, so
    that a particle stands for the dough around it.
    """
    points = positions.astype(np.float64) * (NODES / spacing)
    points -= points.min(axis=0) - (RADIUS * NODES + 3)
    shape = tuple(np.ceil(points.max(axis=0) + RADIUS * NODES + 4).astype(int))
    nodes = np.indices(shape, dtype=np.float32).reshape(3, -1).T
    distance, _ = cKDTree(points).query(nodes, distance_upper_bound=RADIUS * NODES)
    inflated = np.isfinite(distance).reshape(shape)
    depth = ndimage.distance_transform_edt(inflated) - 0.5
    return float((depth > (RADIUS - 0.5) * NODES).sum()) * (spacing / NODES) ** 3


def along(solver: Solver) -> float:
    """Mean pressure [Pa] along x: Hencky's Kirchhoff stress, with the sign of pressure."""
    m = solver.physics.material
    shear = m.young_modulus / (2 * (1 + m.poisson_ratio))
    bulk = m.young_modulus / (3 * (1 - 2 * m.poisson_ratio))
    b = solver.b.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    values, axes = np.linalg.eigh(b)
    logs = 0.5 * np.log(values)
    trace = logs.sum(axis=1, keepdims=True)
    tau = 2 * shear * (logs - trace / 3) + bulk * trace
    return -float((axes[:, 0] ** 2 * tau).sum(axis=1).mean())


def run(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> tuple[Particles, WatchedSolver]:
    """The scene's particles, and the solver at its last key frame."""
    monkeypatch.setattr(mpm, "Solver", WatchedSolver)
    particles = mpm.MpmSimulator(DEFAULT).simulate(scene, rng=np.random.default_rng(0))
    return particles, WatchedSolver.latest


def check(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    particles, solver = run(scene, monkeypatch)
    first, last = (closed_volume(particles.positions[k], particles.spacing) for k in (0, -1))
    # Two rolls are apart at first; the closing fills what is left between them once they touch.
    high = 1.03 if len(scene.bodies) == 1 else 1.05
    assert 0.97 < last / first < high
    # Compressed dough gives way elastically: on average by no more than the yield stress can do.
    m = scene.material
    bulk = m.young_modulus / (3 * (1 - 2 * m.poisson_ratio))
    assert solver.first - m.yield_stress / bulk < mean_volume(solver) < solver.first + 0.005
    solver.advance(SETTLE)
    assert mean_volume(solver) == pytest.approx(solver.first, rel=0.005)


def jittered_block(height: float, *, gravity: float) -> Solver:
    """A block of 20 mm, its particles as scenes jitter them, on a table where there is gravity."""
    grid = np.stack(np.meshgrid(*[np.arange(10)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    jitter = np.random.default_rng(0).uniform(-DEFAULT.jitter, DEFAULT.jitter, grid.shape)
    points = (grid + 0.5 - 5.0 + jitter) * DEFAULT.spacing + [0.0, 0.0, height]
    physics = Physics(
        material=Material(),
        spacing=DEFAULT.spacing,
        dx=DX,
        cfl=DEFAULT.cfl,
        density_cap=DEFAULT.density_cap,
        gravity=gravity,
        low=(-0.05, -0.05, 0.0),
        high=(0.05, 0.05, 0.06),
        table_friction=0.5 if gravity else None,
    )
    return Solver(points, physics, middle=(0.0, 0.0))


def test_resting_dough_stays_as_it_is() -> None:
    """The density of jittered particles is noisy; limiting J by it swells resting dough by no more
    than half a per cent in height or width, and does not let it creep.
    """
    solver = jittered_block(0.010, gravity=9.81)
    start = solver.x.std(axis=0, dtype=np.float64)
    solver.advance(0.1)
    first = solver.x.std(axis=0, dtype=np.float64)
    solver.advance(0.5)
    last = solver.x.std(axis=0, dtype=np.float64)
    assert np.abs(first / start - 1).max() < 0.005
    assert np.abs(last / first - 1).max() < 0.001


@pytest.mark.parametrize("thickness", [0.7, 0.5, 0.35])
def test_pressed_dough_keeps_volume_and_strength(thickness: float) -> None:
    """Pressed without friction to a part of its thickness, a block keeps its closed volume to 4 %
    and carries the yield stress to 20 %, which particles piled up would not.
    """
    solver, side = jittered_block(0.030, gravity=0.0), 0.020
    before = closed_volume(solver.x, DEFAULT.spacing)
    squeeze = Squeeze(
        sdf=finger_sdf(PLATES), position=(0.0, 0.0), yaw=0.0, opening=1.05 * side, rate=-0.1,
        friction=0.0,
    )  # fmt: skip
    solver.advance((1.05 - thickness) * side / 0.1, squeeze=squeeze)
    after = closed_volume(solver.x, DEFAULT.spacing)
    assert after == pytest.approx(before, rel=0.04)
    assert along(solver) == pytest.approx(Material().yield_stress, rel=0.2)


@pytest.mark.parametrize(
    ("family", "number"), [pytest.param(Rolls, 3, marks=pytest.mark.slow), (Doughnut, 4)]
)
def test_volume_of_a_scene(family, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From first to last key frame dough keeps its closed volume, and once the fingers are gone
    mean det b is back within half a per cent.
    """
    check(family().sample(seed=SEED, number=number, split="train"), monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
@pytest.mark.parametrize("family", [Rolls, Doughnut])
def test_volume_of_sampled_scenes(family, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same in ten scenes of each family."""
    check(family().sample(seed=SEED, number=number, split="train"), monkeypatch)
