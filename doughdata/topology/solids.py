"""The solid that particles stand for, on voxels, and its genus.

A solid is the morphological closing of the particles: inflated, then deflated to half a spacing
around the outer particles. Walls along unmerged contacts are taken out again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import distance_transform_edt
from skimage.measure import euler_number, label

from doughdata.topology.pairs import adjacency

__all__ = ["Closing", "Solid", "solid_genus"]

VOXEL = 0.5  # [spacings]
COVER = 0.75  # [spacings], of dough kept around the outer particles
GAP = 1.3  # [spacings]; a lattice leaves no voxel farther than 0.87 from its particles
WALL = 0.9  # [voxels], half a wall; over sqrt(3)/2, so that no diagonal passes through


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """Voxels inside a component. Voxel i has its centre at origin + i * size."""

    inside: Bool[np.ndarray, "nx ny nz"]
    origin: Float64[np.ndarray, " 3"]  # [m], world
    size: float  # [m]


class Closing:
    """Closings of one set of particles with balls of several radii."""

    def __init__(
        self, positions: Float64[np.ndarray, "particles 3"], spacing: float, *, largest: float
    ) -> None:
        """Measure the distance to the particles up to `largest` spacings."""
        self.positions, self.spacing = positions, spacing
        self.size = VOXEL * spacing
        margin = largest * spacing + 2 * self.size
        # Centred on the particles, so that moving them all changes nothing.
        middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
        half = np.ceil((np.ptp(positions, axis=0) / 2 + margin) / self.size).astype(int)
        self.origin = middle - half * self.size
        grid = np.full(2 * half + 1, -1, dtype=np.int64)
        cell = np.rint((positions - self.origin) / self.size).astype(int)
        grid[tuple(cell.T)] = np.arange(len(positions))
        nearest: Any = distance_transform_edt(grid < 0, return_indices=True)
        rough, place = nearest
        self.shape = grid.shape
        self.voxels = np.argwhere(rough * self.size < margin)
        self.particle = grid[tuple(place[:, *self.voxels.T])]
        step = self.centres - positions[self.particle]
        self.distance = np.sqrt(np.einsum("ij,ij->i", step, step))

    @property
    def centres(self) -> Float64[np.ndarray, "voxels 3"]:
        """Centres [m] of the voxels near the particles."""
        return self.origin + self.voxels * self.size

    def solid(self, radius: float) -> Solid:
        """The closing with a ball of `radius` spacings."""
        inflated = np.zeros(self.shape, dtype=bool)
        inflated[tuple(self.voxels[self.distance < radius * self.spacing].T)] = True
        depth = np.asarray(distance_transform_edt(inflated)) * self.size
        return Solid(
            inside=depth > (radius - COVER) * self.spacing, origin=self.origin, size=self.size
        )

    def gaps(self, solid: Solid) -> Float64[np.ndarray, "gaps 3"]:
        """Centres [m] of the voxels that only the closing has filled."""
        filled = solid.inside[tuple(self.voxels.T)] & (self.distance > GAP * self.spacing)
        return self.centres[filled]

    def opened(self, solid: Solid, walls: Int64[np.ndarray, "walls 2"]) -> Solid:
        """The solid without the voxels half-way between the ends of unmerged pairs."""
        if len(walls) == 0:
            return solid
        blocked = _wall_voxels(
            self.positions, self.voxels, self.particle, walls, self.origin, self.size
        )
        inside = solid.inside.copy()
        inside[tuple(self.voxels[blocked].T)] = False
        return Solid(inside=inside, origin=solid.origin, size=solid.size)


def _wall_voxels(
    positions: Float64[np.ndarray, "particles 3"],
    voxels: Int64[np.ndarray, "voxels 3"],
    particle: Int64[np.ndarray, " voxels"],
    walls: Int64[np.ndarray, "walls 2"],
    origin: Float64[np.ndarray, " 3"],
    size: float,
) -> Int64[np.ndarray, " blocked"]:
    """Voxels on the plane half-way between the two particles of an unmerged pair."""
    graph = adjacency(walls, len(positions))
    degree = np.diff(graph.indptr)
    rows = np.flatnonzero(degree[particle] > 0)
    own = particle[rows]
    repeat = degree[own]
    voxel = np.repeat(rows, repeat)
    first = np.cumsum(repeat) - repeat
    within = np.arange(repeat.sum()) - np.repeat(first, repeat)
    other = graph.indices[np.repeat(graph.indptr[own], repeat) + within]
    centre = origin + voxels[voxel] * size
    here, there = positions[particle[voxel]], positions[other]
    step = there - here
    apart = np.linalg.norm(step, axis=1)
    # Signed distance to the bisecting plane of the pair.
    beyond = np.einsum("ij,ij->i", (here + there) / 2 - centre, step) / np.maximum(apart, 1e-12)
    return np.unique(voxel[np.abs(beyond) < WALL * size])


def solid_genus(inside: Bool[np.ndarray, "nx ny nz"]) -> int:
    """Number of independent handles: b1 = b0 + b2 - Euler characteristic (26-connected solid)."""
    if not inside.any():
        return 0
    lumps: Any = label(inside, connectivity=3)
    outside: Any = label(np.pad(~inside, 1, constant_values=True), connectivity=1)
    return int(lumps.max() + (outside.max() - 1) - euler_number(inside, connectivity=3))
