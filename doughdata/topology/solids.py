"""The solid that particles stand for, on voxels, and its genus.

A solid is the morphological closing of the particles: inflated, then deflated to half a spacing
around the outer particles. Walls along unmerged contacts are taken out again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.ndimage import distance_transform_edt, label
from skimage.measure import euler_number

from doughdata.topology.pairs import adjacency

__all__ = ["Solid", "solid_genus", "solids_of"]

VOXEL = 0.5  # [spacings]
COVER = 0.75  # [spacings], of dough kept around the outer particles
WALL = 0.9  # [voxels], half a wall; over sqrt(3)/2, so that no diagonal passes through
FULL = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """Voxels inside a component. Voxel i has its centre at origin + i * size."""

    inside: Bool[np.ndarray, "nx ny nz"]
    origin: Float64[np.ndarray, " 3"]  # [m], world
    size: float  # [m]


def solids_of(
    positions: Float64[np.ndarray, "particles 3"],
    spacing: float,
    *,
    radii: Sequence[float],
    walls: Int64[np.ndarray, "walls 2"],
) -> list[Solid]:
    """Close the particles with balls of several `radii` [spacings].

    `walls` are unmerged pairs of particles: the solid stays open half-way between their ends.
    """
    size = VOXEL * spacing
    margin = max(radii) * spacing + 2 * size
    # Centred on the particles, so that moving them all changes nothing.
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    half = np.ceil((np.ptp(positions, axis=0) / 2 + margin) / size).astype(int)
    origin = middle - half * size
    grid = np.full(2 * half + 1, -1, dtype=np.int64)
    cell = np.rint((positions - origin) / size).astype(int)
    grid[tuple(cell.T)] = np.arange(len(positions))
    rough, place = distance_transform_edt(grid < 0, return_indices=True)
    near = np.argwhere(rough * size < margin)
    particle = grid[tuple(place[:, *near.T])]
    distance = np.linalg.norm(origin + near * size - positions[particle], axis=1)
    blocked = near[:0]
    if len(walls):
        blocked = near[_wall_voxels(positions, near, particle, walls, origin, size)]
    solids = []
    for radius in radii:
        inflated = np.zeros(grid.shape, dtype=bool)
        inflated[tuple(near[distance < radius * spacing].T)] = True
        inside = distance_transform_edt(inflated) * size > (radius - COVER) * spacing
        inside[tuple(blocked.T)] = False
        solids.append(Solid(inside=inside, origin=origin, size=size))
    return solids


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
    _, lumps = label(inside, FULL)
    _, outside = label(np.pad(~inside, 1, constant_values=True))
    return int(lumps + (outside - 1) - euler_number(inside, connectivity=3))
