"""Keeping parts of one component open where they touch without being merged.

The closing would fill a narrow gap between two parts of one body. The topology names the particle
pairs across such gaps. Around them the field gets the empty balls that are too small for the
closing, and a slit one node thick on the bisector, so that the genus of the mesh is that of the
labels. Lengths are in cells.
"""

import numpy as np
from jaxtyping import Float, Float32, Int

from doughdata.registry import require_package

__all__ = ["carve_gaps", "cut_slits", "seams_of"]

SEAMS = 4  # largest seams of a component; the smaller ones are left as the closing has them
BAND = 2.0  # [cells], how far around a carved ball the field is a distance


def seams_of(
    cloud: Float[np.ndarray, "members 3"], pairs: Int[np.ndarray, "pairs 2"], *, reach: float
) -> list[Int[np.ndarray, "_ 2"]]:
    """Unmerged pairs in groups whose particles are linked by steps up to `reach`, largest first."""
    if not len(pairs):
        return []
    spatial = require_package("scipy.spatial", extra="sim")
    sparse = require_package("scipy.sparse", extra="sim")
    csgraph = require_package("scipy.sparse.csgraph", extra="sim")
    touching, ends = np.unique(pairs, return_inverse=True)
    ends = ends.reshape(-1, 2)
    near = spatial.cKDTree(cloud[touching]).query_pairs(reach, output_type="ndarray")
    links = np.concatenate([ends, near])
    ones = np.ones(len(links), np.int8)
    graph = sparse.coo_matrix((ones, (links[:, 0], links[:, 1])), (len(touching),) * 2)
    _, group = csgraph.connected_components(graph, directed=False)
    seam = group[ends[:, 0]]
    order = np.argsort(-np.bincount(seam), kind="stable")
    return [pairs[seam == number] for number in order[:SEAMS] if (seam == number).any()]


def carve_gaps(
    field: Float32[np.ndarray, "nx ny nz"],
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
    *,
    level: float,
) -> None:
    """Raise the field, in place, to the empty balls in the middle of unmerged pairs.

    A ball around the point halfway to the nearest unmerged partner reaches to the nearest particle,
    so nothing within `level` of a particle is carved.

    Args:
        field: closing of the cloud, before a level is subtracted.
        cloud: particles of one component, on the lattice of the field.
        pairs: indices into the cloud of pairs that touch without being merged.
        level: least distance of the surface from particles.
    """
    spatial = require_package("scipy.spatial", extra="sim")
    both = np.concatenate([pairs, pairs[:, ::-1]])
    gap = np.linalg.norm(cloud[both[:, 0]] - cloud[both[:, 1]], axis=1)
    both = both[np.lexsort((gap, both[:, 0]))]
    nearest = both[np.r_[True, both[1:, 0] != both[:-1, 0]]]
    middle = np.unique(cloud[nearest].mean(axis=1), axis=0)
    radius, _ = spatial.cKDTree(cloud).query(middle)
    middle, radius = middle[radius > level], radius[radius > level]
    if not len(middle):
        return
    reach = int(np.ceil(radius.max() - level + BAND))
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1)
    nodes = np.rint(middle).astype(np.int64)[:, None] + steps.reshape(-1, 3)
    value = radius[:, None] - np.linalg.norm(nodes - middle[:, None], axis=2)
    keep = (value > level - BAND) & ((nodes >= 0) & (nodes < field.shape)).all(axis=2)
    np.maximum.at(field, tuple(nodes[keep].T), value[keep].astype(np.float32))


def cut_slits(
    field: Float32[np.ndarray, "nx ny nz"],
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
) -> None:
    """Push nodes on the bisector of unmerged pairs outside, in place.

    Let f be the distance to the nearest unmerged partner of a node's nearest particle, less that
    to this particle. Along a grid edge from one side to the other f sums to at most two cells, so
    dropping nodes with f <= 1 leaves no edge across.
    """
    spatial = require_package("scipy.spatial", extra="sim")
    touching = np.unique(pairs)
    low = np.maximum(np.floor(cloud[touching].min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(cloud[touching].max(axis=0)).astype(int) + 2
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    nodes = np.argwhere(field[box] < 0.0) + low
    distance, nearest = spatial.cKDTree(cloud).query(nodes)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    first = np.searchsorted(both[:, 0], nearest)
    count = np.searchsorted(both[:, 0], nearest, side="right") - first
    which = np.repeat(np.arange(len(nodes)), count)
    if not len(which):
        return
    rank = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    partner = both[first[which] + rank, 1]
    excess = np.linalg.norm(nodes[which] - cloud[partner], axis=1) - distance[which]
    starts = np.flatnonzero(rank == 0)
    least = np.minimum.reduceat(excess, starts)
    cut = least <= 1.0
    chosen = nodes[which[starts[cut]]]
    index = tuple(chosen.T)
    field[index] = np.maximum(field[index], 0.5 * (1.0 - least[cut]) + 0.02)
