"""A full substep of a random cloud, judged by a plain numpy substep in double precision."""

import numpy as np
import pytest

from doughdata.sim.solver import Physics, Solver
from doughschemas import Material

SPACING, DX, DT, FRICTION = 0.002, 0.003125, 1e-4, 0.4
MATERIAL = Material(yield_stress=1500.0)
SHEAR = MATERIAL.young_modulus / (2 * (1 + MATERIAL.poisson_ratio))
BULK = MATERIAL.young_modulus / (3 * (1 - 2 * MATERIAL.poisson_ratio))
LIMIT = np.sqrt(2 / 3) * MATERIAL.yield_stress / (2 * SHEAR)
PACKED = [0, 3, 5, 3, 1, 4, 5, 4, 2]


def random_cloud(*, table: bool, handles: bool) -> Solver:
    """Particles with random velocities, gradients and strains, elastic and plastic."""
    rng = np.random.default_rng(11)
    low = np.array([-0.012, -0.008, 0.0005 if table else -0.006])
    points = rng.uniform(low, low + np.array([0.024, 0.016, 0.012]), (300, 3))
    physics = Physics(
        material=MATERIAL,
        spacing=SPACING,
        dx=DX,
        cfl=0.5,
        density_cap=1.15,
        gravity=9.81,
        low=(-0.05, -0.05, 0.0 if table else -0.05),
        high=(0.05, 0.05, 0.05),
        table_friction=FRICTION if table else None,
    )
    kinds = np.where(points[:, 0] < -0.006, 1, np.where(points[:, 0] > 0.006, 2, 0))
    pull = (0.05, 0.0, 0.0) if handles else (0.0, 0.0, 0.0)
    chosen = kinds.astype(np.int8) if handles else None
    solver = Solver(points, physics, handles=chosen, pull=pull)
    solver.v[:] = rng.normal(0, 0.2, (300, 3))
    solver.C[:] = rng.normal(0, 30.0, (300, 3, 3))
    strain = rng.normal(0, 0.03, (300, 3, 3))
    values, axes = np.linalg.eigh(strain + strain.transpose(0, 2, 1))
    b = np.einsum("nij,nj,nkj->nik", axes, np.exp(2 * values), axes)
    solver.b[:] = b[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    solver.largest[:] = rng.uniform(0.8, 1.5, 300)
    return solver


def stress(b: np.ndarray, largest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """b after radial return and volume cap, and the Kirchhoff stress [Pa]."""
    values, axes = np.linalg.eigh(b)
    logs = 0.5 * np.log(values)
    trace = logs.sum(1, keepdims=True)
    deviator = logs - trace / 3
    size = np.linalg.norm(deviator, axis=1, keepdims=True)
    deviator = deviator * np.minimum(1.0, LIMIT / size)
    trace = np.minimum(trace, np.log(largest)[:, None])

    def turned(diagonal: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj,nkj->nik", axes, diagonal, axes)

    return turned(np.exp(2 * (deviator + trace / 3))), turned(2 * SHEAR * deviator + BULK * trace)


def support(x: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices (n, 27, 3), weights (n, 27) and offsets [m] (n, 27, 3) of the nodes of particles."""
    u = (x - origin) / DX
    nodes = np.floor(u - 0.5).astype(int)[:, None] + np.indices((3, 3, 3)).reshape(3, -1).T
    r = np.abs(u[:, None] - nodes)
    spline = np.where(r < 0.5, 0.75 - r**2, 0.5 * np.maximum(1.5 - r, 0.0) ** 2)
    return nodes, spline.prod(axis=2), nodes * DX + origin - x[:, None]


def move_nodes(solver: Solver, u: np.ndarray, share: np.ndarray, touched: np.ndarray) -> np.ndarray:
    """Gravity, driven nodes (share of each handle, of all) and Coulomb friction at the table."""
    u = u - np.array([0.0, 0.0, 9.81 * DT])
    if solver.handles.any():
        driven = share[:, 0] + share[:, 1] > 0.5 * share[:, 2]
        side = np.where(share[:, 1] > share[:, 0], 1.0, -1.0)
        u = np.where(driven[:, None], side[:, None] * np.array([0.05, 0.0, 0.0]), u)
    if touched.any():
        layer = np.arange(len(u)) % solver._grid.shape[2] <= solver._grid.table
        layer &= touched
        speed = np.linalg.norm(u[:, :2], axis=1)
        keep = np.maximum(0.0, 1 + FRICTION * u[:, 2] / np.maximum(speed, 1e-30))
        stuck = np.column_stack([u[:, :2] * keep[:, None], np.zeros(len(u))])
        u = np.where((layer & (u[:, 2] < 0))[:, None], stuck, u)
    return u


def numpy_substep(solver: Solver, *, table: bool) -> dict[str, np.ndarray]:
    """The state after a substep: MLS-MPM as Hu et al. (2018) write it, nothing rearranged."""
    x, v, C = (a.astype(np.float64) for a in (solver.x, solver.v, solver.C))
    volume = SPACING**3
    mass = MATERIAL.density * volume
    F = np.eye(3) + DT * C
    trial = F @ solver.b.astype(np.float64)[:, PACKED].reshape(-1, 3, 3) @ F.transpose(0, 2, 1)
    b, tau = stress(trial, solver.largest.astype(np.float64))
    shape = np.array(list(solver._grid.shape))
    nodes, w, d = support(x, np.array(list(solver._grid.origin), np.float64))
    at = (nodes[..., 0] * shape[1] + nodes[..., 1]) * shape[2] + nodes[..., 2]
    affine = mass * C - 4 * DT * volume / DX**2 * tau
    momentum = mass * v[:, None] + np.einsum("nij,nkj->nki", affine, d)
    grid, weight, share = np.zeros((shape.prod(), 3)), np.zeros(shape.prod()), None
    np.add.at(grid, at, w[..., None] * momentum)
    np.add.at(weight, at, w * mass)
    kinds = np.stack([solver.handles == 1, solver.handles == 2, solver.handles >= 0], axis=1)
    share = np.zeros((shape.prod(), 3))
    np.add.at(share, at, w[..., None] * kinds[:, None])
    u = np.divide(grid, weight[:, None], out=np.zeros_like(grid), where=weight[:, None] > 0)
    touched = np.zeros(shape.prod(), bool)  # by the support of particles that touch the table
    touched[at[x[:, 2] <= 0.65 * SPACING] if table else []] = True
    u = move_nodes(solver, u, share, touched)
    new_v = np.einsum("nk,nki->ni", w, u[at])
    new_C = 4 / DX**2 * np.einsum("nk,nki,nkj->nij", w, u[at], d)
    density = (w * weight[at]).sum(1) / DX**3
    largest = np.maximum(0.3, 1.15 * MATERIAL.density / density)
    side = np.where(solver.handles == 2, 1.0, -1.0)[:, None]
    new_v = np.where(solver.handles[:, None] > 0, side * np.array([0.05, 0.0, 0.0]), new_v)
    new_x = x + DT * new_v
    if table:
        new_v[:, 2] = np.where(new_x[:, 2] < 0, np.maximum(0.0, new_v[:, 2]), new_v[:, 2])
        new_x[:, 2] = np.maximum(0.0, new_x[:, 2])
    return {"x": new_x, "v": new_v, "C": new_C, "b": b, "largest": largest}


@pytest.mark.parametrize(("table", "handles"), [(False, False), (True, False), (False, True)])
def test_a_substep_is_that_of_the_textbook(table: bool, handles: bool) -> None:
    """Positions, velocities, gradients, strains and volume caps agree to single precision."""
    solver = random_cloud(table=table, handles=handles)
    wanted = numpy_substep(solver, table=table)
    assert solver.advance(DT, steps=1) == 1
    assert np.abs(solver.x - wanted["x"]).max() < 2e-8
    assert np.abs(solver.v - wanted["v"]).max() < 3e-6
    assert np.abs(solver.C - wanted["C"]).max() < 1e-5 * np.abs(wanted["C"]).max()
    packed = solver.b.astype(np.float64)[:, PACKED].reshape(-1, 3, 3)
    assert np.abs(packed - wanted["b"]).max() < 5e-6
    assert np.abs(solver.largest / wanted["largest"] - 1).max() < 1e-5
