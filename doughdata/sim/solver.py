"""One cloud of material points and the call that moves it: what scenes and pull tests share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int8

from doughdata.scenes.sdf import SignedDistanceGrid
from doughdata.sim import contact, kernels
from doughdata.sim._taichi import start
from doughdata.sim.stress import Vec3
from doughschemas import Material, SimulationError

__all__ = ["Physics", "Solver", "Squeeze"]

EDGE = 5  # [cells] of background grid beyond the domain: kernel support and a step's travel


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
    """MLS-MPM state of one cloud, on one thread.

    Args:
        positions: [m], (particles, 3), world; must lie inside the domain.
        physics: material, grid, domain.
        handles: 0 free, 1 and 2 driven against and along `pull`.
        pull: [m/s], velocity of handle 2.
        middle: [m], (x, y) that the grid is centred on: the gap of the first squeeze.
        arch: see `doughdata.sim._taichi.start`.
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
    ) -> None:
        start(arch)
        count = len(positions)
        self.physics = physics
        self.x = np.ascontiguousarray(positions, dtype=np.float32)
        self.v = np.zeros((count, 3), np.float32)
        self.C = np.zeros((count, 3, 3), np.float32)
        self.b = np.zeros((count, 6), np.float32)
        self.b[:, :3] = 1.0
        self.largest = np.full(count, 10.0, np.float32)
        self.handles = np.zeros(count, np.int32) if handles is None else handles.astype(np.int32)
        self._speed = float(np.linalg.norm(pull))
        self._middle = middle
        self._grid = _grid(physics, middle)
        self._dough = _dough(physics, pull, driven=bool(self.handles.any()))
        self._arrays = _grid_arrays(int(np.prod(self._grid.shape)))

    def advance(
        self, seconds: float, *, squeeze: Squeeze | None = None, steps: int | None = None
    ) -> int:
        """Move by an exact stretch of time and return the number of substeps.

        `steps` overrides the number that the CFL limit asks for.

        Raises:
            SimulationError: a particle left the domain, or moved too far in a substep (also NaN).
        """
        if squeeze is not None and squeeze.position != self._middle:
            self._middle = squeeze.position  # nothing on the grid outlives a substep
            self._grid = _grid(self.physics, self._middle)
        fastest = max(0.3, 2.0 * self._speed, 0.0 if squeeze is None else 2.0 * abs(squeeze.rate))
        limit = self.physics.cfl * self.physics.dx / (self.physics.wave_speed + fastest)
        steps = steps or max(1, int(np.ceil(seconds / limit - 1e-9)))
        nodes, colliders, free = self._arrays
        status = np.zeros(8, np.int32)
        sdf = np.zeros(8, np.float32) if squeeze is None else squeeze.sdf.values.reshape(-1)
        kernels.advance(
            steps, seconds / steps, self.x, self.v, self.C, self.b, self.largest, self.handles,
            nodes, colliders, free, sdf, status,
            self._grid, self._dough, _contact(self.physics, squeeze),
        )  # fmt: skip
        self._check(status)
        return steps

    def _check(self, status: np.ndarray) -> None:
        low, high = self.physics.low, self.physics.high
        if status[0] == kernels.LEFT_DOMAIN:
            axis = "xyz"[status[1]]
            raise SimulationError(
                f"dough left the domain along {axis} ({low[status[1]]:g}..{high[status[1]]:g} m)"
            )
        if status[0] == kernels.CFL_BROKEN:
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


def _grid(physics: Physics, middle: tuple[float, float] | None) -> Any:
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
    return kernels.Dough(
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


def _contact(physics: Physics, squeeze: Squeeze | None) -> Any:
    table = physics.table_friction or 0.0
    zero = Vec3(0.0, 0.0, 0.0)
    if squeeze is None:
        return contact.Contact(
            fingers=0, gap=zero, axis=Vec3(1.0, 0.0, 0.0), opening=0.0, rate=0.0,
            friction=0.0, table_friction=table, band=0.0, sdf_origin=zero, sdf_spacing=1.0,
            sdf_shape=contact.Int3(2, 2, 2),
        )  # fmt: skip
    return contact.Contact(
        fingers=2,
        gap=Vec3(*squeeze.position, 0.0),
        axis=Vec3(np.cos(squeeze.yaw), np.sin(squeeze.yaw), 0.0),
        opening=squeeze.opening,
        rate=squeeze.rate,
        friction=squeeze.friction,
        table_friction=table,
        band=0.5 * physics.dx,
        sdf_origin=Vec3(*squeeze.sdf.origin),
        sdf_spacing=squeeze.sdf.spacing,
        sdf_shape=contact.Int3(*squeeze.sdf.values.shape),
    )


_kept: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}


def _grid_arrays(total: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Node arrays of one grid size; the last size is kept, because a run writes before it reads."""
    if total not in _kept:
        _kept.clear()
        _kept[total] = (
            np.zeros((total, 4), np.float32),
            np.zeros((2 * total, 4), np.float32),
            np.zeros(2 * total, np.float32),
        )
    return _kept[total]
