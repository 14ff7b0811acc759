"""The solid that particles stand for, on voxels, and its genus.

A solid is the morphological closing of the particles: inflated, then deflated to half a spacing
around the outer particles. Walls along unmerged contacts are taken out again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix
from skimage.measure import label

from doughdata.topology.pairs import adjacency

__all__ = ["Closing", "Solid", "solid_genus"]

VOXEL = 0.5  # [spacings]
COVER = 0.75  # [spacings], of dough kept around the outer particles
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
        """Measure the distance from every voxel to the particles; `largest` radius in spacings."""
        self.positions, self.spacing = positions, spacing
        self.size = VOXEL * spacing
        # An eroding ball around a voxel of the solid must not leave the grid.
        margin = largest * spacing + max(2, int(_erosion(largest))) * self.size
        # Centred on the particles, so that moving them all changes nothing.
        middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
        half = np.ceil((np.ptp(positions, axis=0) / 2 + margin) / self.size).astype(int)
        self.origin = middle - half * self.size
        self.shape = tuple(2 * half + 1)
        grid = np.full(self.shape, -1, dtype=np.int32)
        cell = np.rint((positions - self.origin) / self.size).astype(int)
        grid[tuple(cell.T)] = np.arange(len(positions))
        place: Any = distance_transform_edt(grid < 0, return_distances=False, return_indices=True)
        nearest = (place[0] * self.shape[1] + place[1]) * self.shape[2] + place[2]
        self.particle = grid.ravel()[nearest]  # one of the nearest; -1 nowhere
        self.distance = self._distances()  # [m], from each voxel to it

    def _distances(self) -> Float64[np.ndarray, "nx ny nz"]:
        square = np.zeros(self.shape)
        for axis, number in enumerate(self.shape):
            along = [1, 1, 1]
            along[axis] = number
            centre = (self.origin[axis] + np.arange(number) * self.size).reshape(along)
            square += (centre - self.positions[:, axis][self.particle]) ** 2
        return np.sqrt(square)

    def solid(self, radius: float) -> Solid:
        """The closing with a ball of `radius` spacings."""
        inflated = self.distance < radius * self.spacing
        return Solid(inside=_eroded(inflated, _erosion(radius)), origin=self.origin, size=self.size)

    def opened(self, solid: Solid, walls: Int64[np.ndarray, "walls 2"]) -> Solid:
        """The solid without the voxels half-way between the ends of unmerged pairs."""
        if len(walls) == 0:
            return solid
        graph = adjacency(walls, len(self.positions))
        beside = np.diff(graph.indptr) > 0
        voxels = np.argwhere(solid.inside & beside[self.particle])
        own = self.particle[tuple(voxels.T)]
        centres = self.origin + voxels * self.size
        blocked = _between(self.positions, centres, own, graph, WALL * self.size)
        inside = solid.inside.copy()
        inside[tuple(voxels[blocked].T)] = False
        return Solid(inside=inside, origin=solid.origin, size=solid.size)


def _erosion(radius: float) -> float:
    """Depth [voxels] that a closing with a ball of `radius` spacings takes off again."""
    return (radius - COVER) / VOXEL


def _eroded(inflated: Bool[np.ndarray, "nx ny nz"], depth: float) -> Bool[np.ndarray, "nx ny nz"]:
    """Voxels farther than `depth` [voxels] from every empty one.

    No full voxel may lie within `depth` of the grid's border: then shifts of the flat array never
    carry a row into the next.
    """
    reach = int(depth)
    axis = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = offsets[(offsets**2).sum(axis=1) <= depth**2 + 1e-6]
    _, rows, columns = inflated.shape
    shifts = ball @ [rows * columns, columns, 1]
    flat = inflated.ravel()
    most = int(shifts.max(initial=0))
    kept = flat[most : len(flat) - most].copy()
    for shift in shifts.tolist():
        kept &= flat[most + shift : len(flat) - most + shift]
    inside = np.zeros(len(flat), dtype=bool)
    inside[most : len(flat) - most] = kept
    return inside.reshape(inflated.shape)


def _between(
    positions: Float64[np.ndarray, "particles 3"],
    centres: Float64[np.ndarray, "voxels 3"],
    own: Int[np.ndarray, " voxels"],
    walls: csr_matrix,
    half: float,
) -> Bool[np.ndarray, " voxels"]:
    """Whether each voxel is within `half` [m] of the plane half-way of a pair of its particle.

    `own` is the particle of each voxel, `walls` the matrix of unmerged pairs.
    """
    degree = np.diff(walls.indptr)
    repeat = degree[own]
    voxel = np.repeat(np.arange(len(own)), repeat)
    first = np.cumsum(repeat) - repeat
    within = np.arange(repeat.sum()) - np.repeat(first, repeat)
    other = walls.indices[np.repeat(walls.indptr[own], repeat) + within]
    here, there = positions[own[voxel]], positions[other]
    step = there - here
    apart = np.sqrt(np.einsum("ij,ij->i", step, step))
    # Signed distance to the bisecting plane of the pair.
    beyond = np.einsum("ij,ij->i", (here + there) / 2 - centres[voxel], step)
    blocked = np.zeros(len(own), dtype=bool)
    blocked[voxel[np.abs(beyond) < half * np.maximum(apart, 1e-12)]] = True
    return blocked


def solid_genus(inside: Bool[np.ndarray, "nx ny nz"]) -> int:
    """Number of independent handles: b1 = b0 + b2 - Euler characteristic (26-connected solid)."""
    if not inside.any():
        return 0
    inside = np.pad(inside, 1)
    lumps: Any = label(inside, connectivity=3)
    outside: Any = label(~inside, connectivity=1)
    return int(lumps.max() + (outside.max() - 1) - _euler(inside))


def _euler(inside: Bool[np.ndarray, "nx ny nz"]) -> int:
    """Euler characteristic of closed voxels: corners - edges + faces - voxels; no full border."""
    _, rows, columns = inside.shape
    solid = inside.ravel()

    def along(cells: Bool[np.ndarray, " cells"], shift: int) -> Bool[np.ndarray, " cells"]:
        met = cells.copy()
        met[:-shift] |= cells[shift:]
        return met

    x, y = rows * columns, columns
    over_z = along(solid, 1)
    over_y, over_yz = along(solid, y), along(over_z, y)
    faces = [along(solid, x), over_y, over_z]
    edges = [over_yz, along(over_z, x), along(over_y, x)]
    corners = np.count_nonzero(along(over_yz, x))
    flat = sum(map(np.count_nonzero, faces)) - sum(map(np.count_nonzero, edges))
    return int(corners + flat - np.count_nonzero(solid))
