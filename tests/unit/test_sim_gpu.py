"""Clouds moved together by atomic sums: on the CPU, and on every GPU driver that is installed.

The order of atomic sums is not fixed, so results differ by rounding. Dough is no chaotic gas: over
the short runs here rounding of 1e-7 a substep stays below 1e-6 m, a two-thousandth of a spacing.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from doughdata.scenes import PRESETS
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim._taichi import gpu_present, start
from doughdata.sim.batch import BatchSolver
from doughdata.sim.mpm import MpmConfig, MpmSimulator
from doughdata.sim.script import Stretch
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughschemas import (
    Action,
    BadInputError,
    Body,
    DoughError,
    Material,
    Particles,
    Scene,
    SimulationError,
)

ARCHS = ["cpu", *filter(gpu_present, ("cuda", "vulkan"))]
SPACING, DX = 0.002, 0.003125
TOLERANCE = 1e-6  # [m]
STEPS = 40
PHYSICS = Physics(
    material=Material(),
    spacing=SPACING,
    dx=DX,
    cfl=0.5,
    density_cap=1.15,
    gravity=9.81,
    low=(-0.08, -0.08, 0.0),
    high=(0.08, 0.08, 0.08),
    table_friction=0.5,
)
FREE = replace(PHYSICS, gravity=0.0, table_friction=None, low=(-0.08, -0.08, -0.08))


@pytest.fixture(scope="module", params=ARCHS)
def arch(request: pytest.FixtureRequest) -> Iterator[str]:
    yield request.param
    start("cpu")


def block(*cells: int, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Jittered lattice points [m] of a box of `cells` spacings a side."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in cells], indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3) + 0.5 - np.array(cells) / 2
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, points.shape)
    return (points + jitter) * SPACING + np.array(centre)


def three(arch: str) -> tuple[list[Solver], list[Stretch]]:
    """Different particles, materials, domains, grids, fingers, time steps and step counts."""
    soft = replace(
        PHYSICS,
        material=Material(young_modulus=20e3, yield_stress=800.0, density=1100.0),
        high=(0.06, 0.09, 0.05),
        table_friction=0.2,
    )
    clouds = [
        Solver(block(10, 10, 8, centre=(0, 0, 0.008)), PHYSICS, arch=arch),
        Solver(block(12, 6, 5, centre=(0.02, -0.01, 0.005)), soft, arch=arch),
        Solver(block(7, 7, 7, centre=(0, 0.03, 0.008)), PHYSICS, middle=(0.001, 0.03), arch=arch),
    ]
    clouds[2].v[:] = [0.1, -0.05, -0.2]
    wide = Squeeze(
        sdf=finger_sdf(PRESETS["regular"]),
        position=(0.0, 0.0),
        yaw=0.3,
        opening=0.022,
        rate=-0.4,
        friction=0.4,
    )
    blade = replace(
        wide, sdf=finger_sdf(PRESETS["narrow"]), position=(0.021, -0.01), yaw=1.5, opening=0.012
    )
    stretches = [
        Stretch(seconds=STEPS * 1.5e-4, squeeze=wide, steps=STEPS),
        Stretch(seconds=(STEPS - 7) * 2e-4, squeeze=blade, steps=STEPS - 7),
        Stretch(seconds=STEPS * 1e-4),
    ]
    return clouds, stretches


@pytest.fixture(scope="module")
def alone() -> list[Solver]:
    """The three clouds after their stretch, each moved by the CPU's solver."""
    clouds, stretches = three("cpu")
    for cloud, stretch in zip(clouds, stretches, strict=True):
        cloud.advance(stretch.seconds, squeeze=stretch.squeeze, steps=stretch.steps)
    return clouds


def farthest(a: Solver, b: Solver) -> float:
    """Largest distance [m] between where two clouds have the same particle."""
    return float(np.linalg.norm(a.x - b.x, axis=1).max())


def check_alone(clouds: list[Solver], alone: list[Solver]) -> None:
    for cloud, other in zip(clouds, alone, strict=True):
        assert farthest(cloud, other) < TOLERANCE
        # tolerance / stretch of time that a difference has built up in
        assert np.abs(cloud.v - other.v).max() < TOLERANCE / (STEPS * 1e-4)
        assert np.abs(cloud.b - other.b).max() < 1e-3


def test_threads_lose_no_sum() -> None:
    """Two threads that add to the same nodes, particles in no order, keep the momenta to 1e-6."""
    positions = np.random.default_rng(0).permutation(block(20, 20, 20))
    cloud = Solver(positions, FREE, threads=2)
    stir(cloud)
    before = momenta(cloud)
    batch = BatchSolver([cloud], threads=2)
    batch.advance([Stretch(seconds=0.006)])
    batch.download()
    check_momenta(cloud, before, limit=1e-6)  # plain sums lose 1e-5 once both threads run at a time


def test_a_batch_moves_each_cloud_as_alone(alone: list[Solver], arch: str) -> None:
    """Three different clouds, moved together, end where the CPU's solver brings each alone."""
    clouds, stretches = three(arch)
    before = [cloud.positions for cloud in clouds]
    batch = BatchSolver(clouds, arch=arch)
    steps = batch.advance(stretches)
    batch.download()
    assert batch.errors == [None, None, None]
    assert steps[:2] == [STEPS, STEPS - 7]
    check_alone(clouds, alone)
    for cloud, start_x in zip(clouds, before, strict=True):  # the tolerance is small beside it
        assert np.linalg.norm(cloud.x - start_x, axis=1).max() > 100 * TOLERANCE


def test_a_failing_cloud_does_not_touch_the_others(alone: list[Solver], arch: str) -> None:
    """Clouds that are no number, too fast or far away are named and frozen; the others go on."""
    clouds, stretches = three(arch)
    bad = [Solver(block(5, 5, 5, centre=(0, 0, 0.04)), PHYSICS, arch=arch) for _ in range(4)]
    bad[0].v[3] = np.nan
    bad[1].v[3] = [0.0, 0.0, 1e4]
    bad[2].x[:, 1] += 0.070
    bad[2].v[:, 1] = 3.0  # leaves after a while
    bad[3].x[7, 0] = np.nan
    batch = BatchSolver([bad[0], clouds[0], bad[1], bad[2], *clouds[1:], bad[3]], arch=arch)
    long = Stretch(seconds=0.0075, steps=50)
    first = [long, stretches[0], long, long, *stretches[1:], long]
    steps = batch.advance(first)
    batch.download()
    check_alone(clouds, alone)
    reasons = ["not a number", None, "m/s", "along y", None, None, "along x"]
    for error, reason in zip(batch.errors, reasons, strict=True):
        assert (reason is None) == (error is None)
        assert reason is None or reason in str(error)
    assert 20 < steps[3] < 50
    assert steps[6] == 0
    frozen = [cloud.positions for cloud in bad]
    assert batch.advance(first)[0] == 0
    for cloud, before in zip(bad, frozen, strict=True):
        assert np.array_equal(cloud.x, before, equal_nan=True)


@pytest.mark.parametrize("yield_stress", [1e9, 300.0])
def test_both_momenta_stay(arch: str, yield_stress: float) -> None:
    """Without outer forces linear and angular momentum stay to 1e-5, elastic or plastic."""
    physics = replace(FREE, material=Material(yield_stress=yield_stress))
    cloud = Solver(block(8, 8, 8), physics, arch=arch)
    stir(cloud)
    before = momenta(cloud)
    batch = BatchSolver([cloud], arch=arch)
    batch.advance([Stretch(seconds=0.006)])
    batch.download()
    assert np.abs(cloud.b[:, 3:]).max() > 0.005  # it was deformed
    check_momenta(cloud, before)


def stir(cloud: Solver) -> None:
    """Let a cloud fly, turn and swing [m/s]."""
    x = cloud.x.astype(np.float64)
    wave = 0.5 * np.sin(150 * x[:, [1, 2, 0]])
    cloud.v[:] = wave + np.array([0.3, -0.2, 0.1]) + np.cross([5.0, 8.0, 20.0], x)


def check_momenta(
    cloud: Solver, before: tuple[np.ndarray, np.ndarray], *, limit: float = 1e-5
) -> None:
    for after, at_first in zip(momenta(cloud), before, strict=True):
        assert np.linalg.norm(after - at_first) < limit * np.linalg.norm(at_first)


def momenta(cloud: Solver) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular momentum, the latter with what APIC keeps in C, by particle mass."""
    x, v, C = (a.astype(np.float64) for a in (cloud.x, cloud.v, cloud.C))
    turn = [C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]]
    return v.sum(0), np.cross(x, v).sum(0) + DX**2 / 4 * np.stack(turn, axis=1).sum(0)


def test_a_box_may_outgrow_its_nodes(arch: str) -> None:
    """A cloud that flies apart, beyond the nodes made for it, keeps its uniform motion."""
    left, right = block(5, 5, 5, centre=(-0.012, 0, 0)), block(5, 5, 5, centre=(0.012, 0, 0))
    cloud = Solver(np.concatenate([left, right]), FREE, arch=arch)
    cloud.v[:, 0] = np.repeat([-3.5, 3.5], 125)
    begin, velocity = cloud.positions, cloud.v.copy()
    batch = BatchSolver([cloud], arch=arch)
    assert batch.advance([Stretch(seconds=0.01, steps=50)]) == [50]
    assert batch.errors == [None]
    assert np.abs(cloud.x - begin - 0.01 * velocity).max() < 2e-6  # 50 roundings of 0.05 m


def test_what_a_batch_refuses(arch: str) -> None:
    """Handles, no clouds, or a wrong number of stretches are refused in words."""
    handles = np.array([1] + [0] * 26, np.int8)
    with pytest.raises(BadInputError, match="without handles"):
        BatchSolver([Solver(block(3, 3, 3), FREE, handles=handles, arch=arch)], arch=arch)
    with pytest.raises(BadInputError, match="needs clouds"):
        BatchSolver([], arch=arch)
    batch = BatchSolver([Solver(block(3, 3, 3), FREE, arch=arch)], arch=arch)
    with pytest.raises(BadInputError, match="expected 1 stretches, got 2"):
        batch.advance([None, None])


CONFIG = MpmConfig(arch="cpu", spacing=0.003, frames=4, settle=0.005)
SQUEEZE = Scene(
    scene_id="squeeze",
    family="test",
    bodies=(Body(shape="roll", parameters={"length": 0.020, "radius": 0.008}),),
    tools=(PRESETS["regular"], PRESETS["narrow"]),
    actions=(Action(opening_start=0.020, opening_end=0.016, speed=0.2),),
)
SCENES = [
    SQUEEZE,
    replace(SQUEEZE, scene_id="away", bodies=(replace(SQUEEZE.bodies[0], position=(0.3, 0.0)),)),
    replace(
        SQUEEZE,
        scene_id="twice",
        bodies=(replace(SQUEEZE.bodies[0], yaw=0.4),),
        actions=(
            Action(opening_start=0.020, opening_end=0.017, speed=0.2, hold=0.002, release=True),
            Action(opening_start=0.030, opening_end=0.028, tool=1, yaw=1.2, speed=0.2),
        ),
    ),
    replace(
        SQUEEZE,
        scene_id="inside",
        actions=(
            Action(
                opening_start=0.020, opening_end=0.016, speed=0.2, position=(0.013, 0.0), tool=1
            ),
        ),
    ),
]


@pytest.fixture(scope="module")
def simulated() -> list[Particles | DoughError]:
    """Every scene by the CPU's simulator, alone."""
    results: list[Particles | DoughError] = []
    for k, scene in enumerate(SCENES):
        try:
            results.append(MpmSimulator(CONFIG).simulate(scene, rng=np.random.default_rng(k)))
        except DoughError as error:
            results.append(error)
    return results


def test_scenes_together(simulated: list[Particles | DoughError], arch: str) -> None:
    """Scenes of different lengths give, together, the key frames and errors of each alone."""
    rngs = [np.random.default_rng(k) for k in range(len(SCENES))]
    results = MpmSimulator(replace(CONFIG, arch=arch)).simulate_batch(SCENES, rngs=rngs)
    assert [type(r) for r in simulated] == [Particles, SimulationError, Particles, SimulationError]
    for result, expected in zip(results, simulated, strict=True):
        if isinstance(expected, DoughError):
            assert type(result) is type(expected)
            assert str(result) == str(expected)
        else:
            assert isinstance(result, Particles)
            assert np.abs(result.positions - expected.positions).max() < TOLERANCE
            assert np.array_equal(result.timestamps, expected.timestamps)
            assert np.array_equal(result.tool_poses.opening, expected.tool_poses.opening)
            assert np.ptp(expected.positions, axis=0).max() > 100 * TOLERANCE
