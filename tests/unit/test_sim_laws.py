"""Laws of mechanics that the solver must obey: closed forms, each with its tolerance.

| law                                              | tolerance       |
|--------------------------------------------------|-----------------|
| free spin keeps linear and angular momentum      | 1e-5            |
| free bar: T = 2 L / sqrt(E / rho)                | 1 %             |
| colliding blocks: total momentum, restitution    | 1e-4, 0.5 to 1  |
| cantilever: bending and shear under own weight   | 5 %             |
| yield cap: sigma_vm <= sigma_y                   | 1e-4            |
| bar pulled past yield carries sigma_y            | 2 %             |
| block pressed without friction carries sigma_y   | 5 %, 3 % finer  |
| plastic return leaves det b alone                | 1e-5            |
| free fall: g t^2 / 2                             | 0.2 %           |
| rest on the table                                | 0.25 cells      |
| sliding block: mu g                              | 5 %             |
"""

from dataclasses import replace

import numpy as np
import pytest

from doughdata.scenes.sdf import finger_sdf
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughdata.sim.transfers import LONGEST_MOVE
from doughschemas import Material, SimulationError, Tool

SPACING, DX = 0.002, 0.003125
ELASTIC = Material(yield_stress=1e9)


def block(cells: tuple[int, int, int], *, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Lattice points [m] of a box of `cells` spacings a side."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in cells], indexing="ij"), axis=-1)
    return ((grid + 0.5 - np.array(cells) / 2) * SPACING).reshape(-1, 3) + np.array(centre)


def physics(
    *, material: Material = ELASTIC, gravity: float = 0.0, friction=None, half: float = 0.08
):
    """A free domain, or a table at z = 0 where a friction is given."""
    return Physics(
        material=material,
        spacing=SPACING,
        dx=DX,
        cfl=0.4,
        density_cap=1.0,
        gravity=gravity,
        low=(-half, -half, -half if friction is None else 0.0),
        high=(half, half, half),
        table_friction=friction,
    )


def angular_momentum(solver: Solver) -> np.ndarray:
    """Sum of x cross v and of what APIC stores in C, per unit of particle mass."""
    x, v, C = (a.astype(np.float64) for a in (solver.x, solver.v, solver.C))
    spin = np.stack(
        [C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1
    )
    return np.cross(x, v).sum(0) + DX**2 / 4 * spin.sum(0)


def symmetric(solver: Solver) -> np.ndarray:
    """b of every particle as 3 x 3 matrices."""
    return solver.b.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)


def mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress [Pa] of every particle."""
    dev = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
    return np.sqrt(1.5 * (dev**2).sum((1, 2)))


def hencky_stress(solver: Solver) -> np.ndarray:
    """Kirchhoff stress [Pa] of every particle, from b by numpy's eigenvalues."""
    m = solver.physics.material
    shear = m.young_modulus / (2 * (1 + m.poisson_ratio))
    bulk = m.young_modulus / (3 * (1 - 2 * m.poisson_ratio))
    values, axes = np.linalg.eigh(symmetric(solver))
    logs = 0.5 * np.log(values)
    trace = logs.sum(1, keepdims=True)
    return np.einsum("nij,nj,nkj->nik", axes, 2 * shear * (logs - trace / 3) + bulk * trace, axes)


@pytest.mark.parametrize("yield_stress", [1e9, 300.0])
def test_free_spin_keeps_both_momenta(yield_stress: float) -> None:
    """Over 1000 steps without outer forces both momenta stay to 1e-5, elastic or plastic."""
    solver = Solver(block((10, 10, 10)), physics(material=Material(yield_stress=yield_stress)))
    omega = np.array([5.0, 8.0, 20.0])
    x = solver.x.astype(np.float64)
    solver.v[:] = np.cross(omega, x) + [0.3, -0.2, 0.1] + 0.5 * np.sin(150 * x[:, [1, 2, 0]])
    linear, angular = solver.v.astype(np.float64).sum(0), angular_momentum(solver)
    solver.advance(0.1, steps=1000)
    after = solver.v.astype(np.float64).sum(0)
    assert np.linalg.norm(after - linear) < 1e-5 * np.linalg.norm(linear)
    assert np.linalg.norm(angular_momentum(solver) - angular) < 1e-5 * np.linalg.norm(angular)


def test_free_bar_period() -> None:
    """A free bar without lateral contraction rings with T = 2 L / sqrt(E / rho) to 1 %."""
    material = Material(yield_stress=1e9, poisson_ratio=0.0)
    solver = Solver(block((50, 5, 5)), physics(material=material))
    length = 50 * SPACING
    shape = -np.sin(np.pi * solver.x[:, 0] / length)
    solver.v[:, 0] = 0.05 * shape
    period = 2 * length / np.sqrt(material.young_modulus / material.density)
    step, amplitude = period / 100, []
    for _ in range(180):
        solver.advance(step)
        amplitude.append(float((solver.v[:, 0] * shape).sum()))
    signal = np.array(amplitude)
    crossing = np.flatnonzero(signal[:-1] * signal[1:] < 0)
    times = crossing + signal[crossing] / (signal[crossing] - signal[crossing + 1])
    assert len(times) >= 3
    assert (times[2] - times[0]) / 100 == pytest.approx(1.0, abs=0.01)


def test_colliding_blocks() -> None:
    """Two elastic blocks that collide keep their momentum, and part no faster than they met."""
    left, right = block((8, 8, 8), centre=(-0.014, 0, 0)), block((8, 8, 8), centre=(0.014, 0, 0))
    solver = Solver(np.concatenate([left, right]), physics())
    first = len(left)
    solver.v[:first, 0], solver.v[first:, 0] = 0.3, -0.3
    solver.advance(0.12)
    speeds = solver.v[:first, 0].mean(), solver.v[first:, 0].mean()
    assert abs(speeds[0] + speeds[1]) < 1e-4 * 0.3
    assert 0.5 < -speeds[0] / 0.3 <= 1.0


def test_bar_yields_at_the_yield_stress() -> None:
    """A bar pulled at both ends carries sigma_y along its axis: von Mises' uniaxial plateau."""
    material = Material()
    positions = block((30, 8, 8))
    handles = np.where(positions[:, 0] < -0.024, 1, np.where(positions[:, 0] > 0.024, 2, 0))
    solver = Solver(
        positions,
        physics(material=material),
        handles=handles.astype(np.int8),
        pull=(0.05, 0.0, 0.0),
    )
    solver.advance(0.04)  # 4 mm on 48: eight per cent, against four at yield
    middle = np.abs(positions[:, 0]) < 0.012
    stress = hencky_stress(solver)[middle]
    assert stress[:, 0, 0].mean() == pytest.approx(material.yield_stress, rel=0.02)
    assert abs(stress[:, 1, 1].mean()) < 0.02 * material.yield_stress
    assert mises(hencky_stress(solver)).max() <= material.yield_stress * (1 + 1e-4)


@pytest.mark.parametrize(("count", "tolerance"), [(12, 0.05), (25, 0.03)])
def test_pressed_block_yields_at_the_yield_stress(count: int, tolerance: float) -> None:
    """A block of 8 cells a side, pressed by 12 % without friction, carries sigma_y along the
    closing axis and nothing across it; of 16 cells, more exactly.
    """
    side, material = 0.025, Material()
    spacing, rate = side / count, -0.1
    free = replace(physics(material=material, half=0.03), spacing=spacing, dx=1.5625 * spacing)
    # The grid is centred on the gap; the block is as high as the middle of the fingers.
    positions = block((count,) * 3) * (spacing / SPACING) + [0.0, 0.0, 0.025]
    free = replace(free, high=(0.03, 0.03, 0.05))
    solver = Solver(positions, free, middle=(0.0, 0.0))
    plates = finger_sdf(Tool(name="plate", depth=0.010, width=0.050, height=0.050))
    squeeze = Squeeze(
        sdf=plates, position=(0.0, 0.0), yaw=0.0, opening=1.05 * side, rate=rate, friction=0.0
    )
    solver.advance((0.88 - 1.05) * side / rate, squeeze=squeeze)
    stress = hencky_stress(solver)
    assert -stress[:, 0, 0].mean() == pytest.approx(material.yield_stress, rel=tolerance)
    assert np.abs(stress[:, [1, 2], [1, 2]].mean(0)).max() < 0.02 * material.yield_stress
    assert mises(stress).max() <= material.yield_stress * (1 + 1e-4)


def test_plastic_return_keeps_the_volume() -> None:
    """One step far past yield multiplies det b by det(I + dt C)^2, as without yield, to 1e-5."""
    solver = Solver(block((8, 8, 8)), physics(material=Material(yield_stress=300.0)))
    dt = 1e-4
    solver.C[:] = np.random.default_rng(0).normal(0.0, 0.05 / dt, solver.C.shape)
    solver.C[:] -= np.trace(solver.C, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
    law = np.linalg.det(np.eye(3) + dt * solver.C.astype(np.float64)) ** 2
    solver.advance(dt, steps=1)
    assert mises(hencky_stress(solver)).max() <= 300.0 * (1 + 1e-4)
    assert np.abs(np.linalg.det(symmetric(solver)) / law - 1).max() < 1e-5


def test_cantilever_sags_as_timoshenko_says() -> None:
    """A beam of 8 cells across, held at its middle, sags at both ends by rho g A L^4 / 8 E I and
    the shear rho g L^2 / 2 k G, to 5 %: by symmetry either half is clamped without a slope.
    """
    half, high, wide, gravity = 60, 13, 4, 0.3
    material = Material(yield_stress=1e9, poisson_ratio=0.0)
    length, height = half * SPACING, high * SPACING
    load, modulus = material.density * gravity, material.young_modulus
    bending = load * height * length**4 / (8 * modulus * height**3 / 12)
    shear = load * length**2 / (2 * (5 / 6) * modulus / 2)
    positions = block((2 * half, wide, high))
    handles = (np.abs(positions[:, 0]) < SPACING).astype(np.int8)
    free = physics(material=material, gravity=gravity)
    free = replace(free, low=(-0.13, -0.03, -0.04), high=(0.13, 0.03, 0.04))
    solver = Solver(positions, free, handles=handles)
    tip, before, peaks = np.abs(positions[:, 0]) > length - SPACING, 0.0, 0
    period = 2 * np.pi * length**2 / 1.875104**2 * np.sqrt(12 * material.density / modulus) / height
    while peaks < 6:  # kinetic damping: at rest where its motion is fastest is at equilibrium
        solver.advance(period / 60)
        energy = float((solver.v.astype(np.float64) ** 2).sum())
        if energy < before:
            solver.v[:], solver.C[:], energy, peaks = 0.0, 0.0, 0.0, peaks + 1
        before = energy
    sag = -float(solver.x[tip, 2].astype(np.float64).mean())
    assert sag == pytest.approx(bending + shear, rel=0.05)


def test_free_fall() -> None:
    """Before it touches anything a block falls by g t^2 / 2 and keeps its shape."""
    solver = Solver(block((6, 6, 6), centre=(0, 0, 0.05)), physics(gravity=9.81, friction=0.5))
    before, seconds = solver.positions.astype(np.float64), 0.08
    solver.advance(seconds)
    moved = solver.x - before
    assert moved[:, 2].mean() == pytest.approx(-0.5 * 9.81 * seconds**2, rel=2e-3)
    assert np.abs(moved - moved.mean(0)).max() < 1e-5


def test_rest_on_the_table() -> None:
    """A block laid on the table stays where it is, less its own sag, and nothing is below z = 0."""
    positions = block((10, 10, 10), centre=(0, 0, 0.010))
    solver = Solver(positions, physics(material=Material(), gravity=9.81, friction=0.5))
    solver.advance(0.3)
    # Own weight, rho g h / 2E, sags it by 0.03 mm; a node layer carries it within 0.25 dx.
    assert abs(solver.x[:, 2].mean() - 0.010) < 0.25 * DX
    assert solver.x[:, 2].min() >= 0.0
    assert np.abs(solver.v).max() < 0.01


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_friction_stops_a_sliding_block(friction: float) -> None:
    """A sliding block slows down by mu g; without friction it does not."""
    positions = block((10, 10, 6), centre=(0, 0, 0.006))
    solver = Solver(positions, physics(gravity=9.81, friction=friction))
    solver.advance(0.1)
    solver.v[:, 0] += 0.3
    seconds = 0.05  # it would stop after 0.102 s
    start = solver.v[:, 0].astype(np.float64).mean()
    solver.advance(seconds)
    slowed = (start - solver.v[:, 0].astype(np.float64).mean()) / seconds
    assert slowed == pytest.approx(friction * 9.81, rel=0.05, abs=1e-3)


def test_leaving_the_domain_is_named() -> None:
    """Dough that flies out of the domain is an error that names the axis, not a crash."""
    solver = Solver(block((4, 4, 4)), physics())
    solver.v[:, 1] = 0.5
    with pytest.raises(SimulationError, match=r"left the domain along y"):
        solver.advance(1.0)


def test_too_long_a_substep_is_made_shorter() -> None:
    """Dough that flies faster than its own waves moves by v t, although the first choice of the
    substep, which counts dough up to that speed, would move it too far at once.
    """
    solver = Solver(block((4, 4, 4)), physics())
    speed = 4.0 * solver.physics.wave_speed
    solver.v[:, 0] = speed
    before, seconds = solver.x.astype(np.float64), 0.01 / speed
    chosen = solver.substeps(seconds)
    assert speed * seconds / chosen > LONGEST_MOVE * DX
    assert solver.advance(seconds) > chosen
    assert np.abs(solver.x - before - [0.01, 0.0, 0.0]).max() < 1e-5


@pytest.mark.parametrize(("value", "reason"), [(np.nan, "not a number"), (1e4, r"1\.73e\+04 m/s")])
def test_instability_is_named(value: float, reason: str) -> None:
    """A velocity that is no number, or too fast for the substep, is an error that says so."""
    solver = Solver(block((4, 4, 4)), physics())
    solver.v[:] = value
    with pytest.raises(SimulationError, match=reason):
        solver.advance(0.01)


def test_a_run_in_parts_is_the_run_in_one() -> None:
    """Two stretches of whole substeps give the bytes of one: nothing hides between calls."""
    whole, parts = (
        Solver(block((6, 6, 6), centre=(0, 0, 0.006)), physics(friction=0.5, gravity=9.81))
        for _ in "ab"
    )
    limit = 0.4 * DX / (whole.physics.wave_speed + 0.3)
    whole.advance(60 * limit)
    parts.advance(30 * limit)
    parts.advance(30 * limit)
    assert np.array_equal(whole.x, parts.x)
    assert np.array_equal(whole.b, parts.b)
