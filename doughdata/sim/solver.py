"""One cloud of material points and the call that moves it: what scenes and pull tests share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int8, Int32, Int64

from doughdata.scenes.sdf import MARGIN, SignedDistanceGrid
from doughdata.sim import contact, kernels
from doughdata.sim._taichi import Bound, start
from doughdata.sim.stress import Vec3
from doughdata.sim.transfers import CFL_BROKEN, LEFT_DOMAIN, Dough
from doughschemas import Material, SimulationError

__all__ = ["RETRIES", "Physics", "Solver", "Squeeze", "contact_of", "grid_of"]

REACH = 0.65  # spacings; the outermost particles of resting dough are 0.5 from a wall
RETRIES = 2  # of a stretch that broke the limit, each with half the substep: waves grew within it
EDGE = 5  # [cells] of background grid beyond the domain: kernel support and a step's travel
STABLE = 0.9  # of dx, that the fastest wave of the dough as it is may cross; 0.98 was the limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Physics:
    """What stays the same while a cloud moves."""

    material: Material
    spacing: float  # [m], of the particles at rest
    dx: float  # [m], background grid
    cfl: float  # fraction of dx that the fastest wave crosses in a substep
    density_cap: float  # J is limited to this times reference over real density
    gravity: float  # [m/s2]
    low: tuple[float, float, float]  # [m], corner of the domain
    high: tuple[float, float, float]
    table_friction: float | None  # Coulomb coefficient; None = no table

    @property
    def wave_speed(self) -> float:
        """Speed of pressure waves [m/s], sqrt((lambda + 2 mu) / rho)."""
        m = self.material
        modulus = m.young_modulus * (1 - m.poisson_ratio)
        modulus /= (1 + m.poisson_ratio) * (1 - 2 * m.poisson_ratio)
        return float(np.sqrt(modulus / m.density))


@dataclass(frozen=True, slots=True, kw_only=True)
class Squeeze:
    """Both fingers during a stretch of time in which their opening changes linearly."""

    sdf: SignedDistanceGrid
    position: tuple[float, float]  # [m], middle of the gap
    yaw: float  # [rad]
    opening: float  # [m], at the start
    rate: float  # [m/s], change of the opening; negative while it closes
    friction: float


class Solver:
    """MLS-MPM state of one cloud, all arrays in the order of `positions`.

    The same bytes come out for every number of threads.

    Args:
        positions: [m], (particles, 3), world; must lie inside the domain.
        physics: material, grid, domain.
        handles: 0 free, 1 and 2 driven against and along `pull`.
        pull: [m/s], velocity of handle 2.
        middle: [m], (x, y) that the grid is centred on: the gap of the first squeeze.
        arch: see `doughdata.sim._taichi.start`.
        threads: of the CPU. Worth it on idle cores alone, because threads wait awake.
    """

    def __init__(
        self,
        positions: Float64[np.ndarray, "particles 3"],
        physics: Physics,
        *,
        handles: Int8[np.ndarray, " particles"] | None = None,
        pull: tuple[float, float, float] = (0.0, 0.0, 0.0),
        middle: tuple[float, float] | None = None,
        arch: str = "cpu",
        threads: int = 1,
    ) -> None:
        start(arch, threads=threads)
        count = len(positions)
        self.physics = physics
        self.x = np.ascontiguousarray(positions, dtype=np.float32)
        self.v = np.zeros((count, 3), np.float32)
        self.C = np.zeros((count, 3, 3), np.float32)
        self.b = np.zeros((count, 6), np.float32)
        self.b[:, :3] = 1.0
        self.largest = np.full(count, 10.0, np.float32)
        self.handles = np.zeros(count, np.int32) if handles is None else handles.astype(np.int32)
        self._arch, self._threads = arch, threads
        self._speed = float(np.linalg.norm(pull))
        self._middle = middle
        self._grid = grid_of(physics, middle)
        self._dough = _dough(physics, pull, driven=bool(self.handles.any()))
        self._order = _slice_order(self.x, physics.dx)

    def advance(
        self, seconds: float, *, squeeze: Squeeze | None = None, steps: int | None = None
    ) -> int:
        """Move by an exact stretch of time and return the number of substeps.

        `steps` overrides the number that the CFL limit asks for. That number is chosen from the
        dough as it is; where that was too few, the stretch is run again with twice as many.

        Raises:
            SimulationError: a particle left the domain, or moved too far in a substep (also NaN).
        """
        if squeeze is not None and squeeze.position != self._middle:
            self._middle = squeeze.position  # nothing on the grid outlives a substep
            self._grid = grid_of(self.physics, self._middle)
        tries = RETRIES if steps is None else 0
        steps = steps or self.substeps(seconds, squeeze=squeeze)
        start(self._arch, threads=self._threads)  # another solver may have asked for others
        state = _Rows(self, self._order)
        status = self._run(state, steps, seconds / steps, squeeze)
        while tries and (status[::2] == CFL_BROKEN).any():
            tries, steps = tries - 1, 2 * steps
            state = _Rows(self, self._order)
            status = self._run(state, steps, seconds / steps, squeeze)
        state.store(self)
        for found in status.reshape(-1, 2):
            if found[0] == CFL_BROKEN:
                found[1] = self._order[found[1]]
            self.check(found)
        return steps

    def substeps(self, seconds: float, *, squeeze: Squeeze | None = None) -> int:
        """How many substeps a stretch of time needs, from the dough as it is now.

        Waves, fingers and dough in motion count, up to dough as fast as its waves: beyond that a
        run is lost and must fail. Squeezed dough carries faster waves: Hencky's energy gives
        c sqrt(1 - log J) along a stretch of J alone.
        """
        p, finite = self.physics, np.isfinite(self.v).all() and np.isfinite(self.b).all()
        moving = min(float(np.linalg.norm(self.v, axis=1).max()), p.wave_speed) if finite else 0.0
        driven = max(self._speed, 0.0 if squeeze is None else abs(squeeze.rate))
        limit = p.cfl * p.dx / (p.wave_speed + 2.0 * max(0.15, driven, moving))
        if finite:
            squeezed = 1.0 - 0.5 * np.log(np.clip(_determinant(self.b).min(), 1e-8, 1.0))
            limit = min(limit, STABLE * p.dx / (p.wave_speed * np.sqrt(squeezed) + moving))
        return max(1, int(np.ceil(seconds / limit - 1e-9)))

    def _run(
        self, state: "_Rows", steps: int, dt: float, squeeze: Squeeze | None
    ) -> Int32[np.ndarray, " status"]:
        """All substeps, on one thread or several: the kernels' status."""
        parts, nodes, colliders, free, touch = _grid_arrays(int(np.prod(self._grid.shape)))
        status = np.zeros(2 * kernels.SLICES, np.int32)
        boxes = np.zeros(kernels.NEAR + 6, np.int32)
        sdf = np.zeros(8, np.float32) if squeeze is None else squeeze.sdf.values.reshape(-1)
        s, structs = state, (self._grid, self._dough, contact_of(self.physics, squeeze))
        seen = (colliders, free, touch, sdf, boxes, status, *structs)
        moved = (s.x, s.motion, s.b, s.handles, parts, nodes, *seen)
        clock = np.zeros(3, np.int32)
        look = Bound(kernels.look, clock, dt, s.x, s.handles, *seen)
        advance = Bound(kernels.advance, self._threads, clock, dt, *moved)
        for first in range(0, steps, kernels.EVERY):
            clock[:] = first, min(kernels.EVERY, steps - first), 0
            look()
            if status.any():
                break
            advance()
        return status

    def check(self, status: np.ndarray) -> None:
        """Turn a kernel's (reason, detail) into an error in words.

        Raises:
            SimulationError: there is a reason.
        """
        low, high = self.physics.low, self.physics.high
        if status[0] == LEFT_DOMAIN:
            axis = "xyz"[status[1]]
            raise SimulationError(
                f"dough left the domain along {axis} ({low[status[1]]:g}..{high[status[1]]:g} m)"
            )
        if status[0] == CFL_BROKEN:
            where = ", ".join(f"{value:.3f}" for value in self.x[status[1]])
            speed = float(np.linalg.norm(self.v[status[1]]))
            reason = "not a number" if np.isnan(speed) else f"{speed:.3g} m/s"
            raise SimulationError(
                f"a particle at ({where}) m broke the time-step limit (speed {reason}); "
                f"lower cfl (now {self.physics.cfl:g})"
            )

    @property
    def positions(self) -> Float32[np.ndarray, "particles 3"]:
        """Copy of the positions [m], world."""
        return self.x.copy()


class _Rows:
    """The state of a solver in slice order and in the rows that `transfers` describes."""

    def __init__(self, solver: Solver, order: Int64[np.ndarray, " particles"]) -> None:
        count = len(order)
        self.order = order
        self.x = np.concatenate([solver.x, solver.largest[:, None]], axis=1)[order]
        motion = np.zeros((count, 4, 4), np.float32)
        motion[:, 0, :3], motion[:, 0, 3] = solver.v[order], 1.0
        motion[:, 1:, :3] = solver.C.transpose(0, 2, 1)[order]
        self.motion = motion.reshape(-1, 4)
        self.b = solver.b[order]
        self.handles = solver.handles[order]

    def store(self, solver: Solver) -> None:
        """Bring a solver's arrays up to date."""
        solver.x[self.order], solver.largest[self.order] = self.x[:, :3], self.x[:, 3]
        motion = self.motion.reshape(-1, 4, 4)[:, :, :3]
        solver.v[self.order], solver.b[self.order] = motion[:, 0], self.b
        solver.C[self.order] = motion[:, 1:].transpose(0, 2, 1)


def _slice_order(x: Float32[np.ndarray, "particles 3"], dx: float) -> Int64[np.ndarray, " _"]:
    """Particles by cell, the longest axis of the cloud first: slices overlap in few layers.

    Taken once: dough does not mix, and a run in parts must be the run in one.
    """
    cells = np.floor(x / dx).astype(np.int64)
    axes = np.argsort(np.ptp(cells, axis=0), kind="stable")
    return np.lexsort([cells[:, axis] for axis in axes])


def _determinant(b: Float32[np.ndarray, "particles 6"]) -> Float64[np.ndarray, " particles"]:
    """Of the packed symmetric matrices (xx, yy, zz, xy, yz, xz)."""
    full = b.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]]
    return np.linalg.det(full.reshape(-1, 3, 3))


def grid_of(physics: Physics, middle: tuple[float, float] | None) -> Any:
    """Background grid over the domain; with a table, a layer of nodes lies exactly on it.

    `middle` [m] becomes the centre of a cell. A node there could not move sideways, by symmetry,
    and a film seven times too dense would stay between thin fingers (measured: 3 mm blade).
    """
    dx, low, high = physics.dx, np.array(physics.low), np.array(physics.high)
    x, y = (0.0, 0.0) if middle is None else (middle[0] + dx / 2, middle[1] + dx / 2)
    anchor = np.array([x, y, 0.0])
    first = np.floor((low - anchor) / dx).astype(int) - EDGE
    shape = np.ceil((high - low) / dx).astype(int) + 2 * EDGE + 2
    table = -1 if physics.table_friction is None else -int(first[2])
    return contact.Grid(
        origin=Vec3(*(anchor + first * dx)),
        dx=dx,
        inverse=1.0 / dx,
        shape=contact.Int3(*shape),
        table=table,
    )


def _dough(physics: Physics, pull: tuple[float, float, float], *, driven: bool) -> Any:
    m = physics.material
    shear = m.young_modulus / (2 * (1 + m.poisson_ratio))
    return Dough(
        shear=shear,
        bulk=m.young_modulus / (3 * (1 - 2 * m.poisson_ratio)),
        yield_strain=float(np.sqrt(2 / 3)) * m.yield_stress / (2 * shear),
        volume=physics.spacing**3,
        mass=m.density * physics.spacing**3,
        gravity=physics.gravity,
        density_cap=physics.density_cap,
        driven=int(driven),
        pull=Vec3(*pull),
    )


def contact_of(physics: Physics, squeeze: Squeeze | None) -> Any:
    """Fingers and table as the kernels take them."""
    table = physics.table_friction or 0.0
    reach, zero = REACH * physics.spacing, Vec3(0.0, 0.0, 0.0)
    if squeeze is None:
        return contact.Contact(
            fingers=0, gap=zero, axis=Vec3(1.0, 0.0, 0.0), opening=0.0, rate=0.0,
            friction=0.0, table_friction=table, reach=reach, band=0.0, sdf_origin=zero,
            sdf_spacing=1.0, sdf_shape=contact.Int3(2, 2, 2), sdf_beyond=0.0,
        )  # fmt: skip
    return contact.Contact(
        fingers=2,
        gap=Vec3(*squeeze.position, 0.0),
        axis=Vec3(np.cos(squeeze.yaw), np.sin(squeeze.yaw), 0.0),
        opening=squeeze.opening,
        rate=squeeze.rate,
        friction=squeeze.friction,
        table_friction=table,
        reach=reach,
        band=0.5 * physics.dx,
        sdf_origin=Vec3(*squeeze.sdf.origin),
        sdf_spacing=squeeze.sdf.spacing,
        sdf_shape=contact.Int3(*squeeze.sdf.values.shape),
        sdf_beyond=MARGIN,
    )


_kept: dict[int, tuple[np.ndarray, ...]] = {}


def _grid_arrays(total: int) -> tuple[np.ndarray, ...]:
    """Node arrays of one grid size; the last size is kept, because a run writes before it reads."""
    if total not in _kept:
        _kept.clear()
        rows = (kernels.SLICES * total, total, 2 * total)  # of the slices, their sum, colliders
        _kept[total] = (
            *(np.zeros((count, 4), np.float32) for count in rows),
            np.zeros(2 * total, np.float32),
            np.zeros(total, np.int32),
        )
    return _kept[total]
