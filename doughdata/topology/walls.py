"""Walls: where a solid made of balls would bridge two surfaces that are no one piece.

Balls around particles fill narrow gaps. Where the particles on both sides of such a gap are bonded
to each other over a few steps, that is right: a fold, the rim of a seam, a thin place. Where they
are not, the gap is real and the solid has to stay open.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from doughdata.topology.crops import chunks
from doughdata.topology.pairs import adjacency, connected

__all__ = ["find_walls"]

HOPS = 3  # bonds between two particles of one piece, at most, across a gap that may be filled
LINK = 2.2  # [spacings], between two wall pairs of one gap
LOCAL = 0.006  # [m]; sides that join within this of a gap are one
CHUNK = 0.008  # [m], length of a gap that is judged at once
FEWEST_PAIRS = 12  # of a wall; fewer are noise


def find_walls(
    positions: Float64[np.ndarray, "particles 3"],
    bonds: Int64[np.ndarray, "bonds 2"],
    contacts: Int64[np.ndarray, "contacts 2"],
    bridges: Int64[np.ndarray, "bridges 2"],
    *,
    spacing: float,
    widest: float,
) -> Int64[np.ndarray, "walls 2"]:
    """Pairs of particles of one component between which the solid must stay open.

    `bonds` are short bonded pairs, `contacts` unmerged near pairs, `bridges` pairs without a bond
    between which the solid would be filled, `widest` [m] the widest gap that it fills.
    """
    core = np.zeros(len(positions), dtype=bool)
    core[contacts.ravel()] = True
    core[bridges.ravel()] = True
    chosen = np.flatnonzero(core)
    if len(chosen) < 2:
        return np.zeros((0, 2), np.int64)
    pairs = KDTree(positions[chosen]).query_pairs(widest, output_type="ndarray")
    pairs = chosen[pairs]
    walls = pairs[~_joined(bonds, pairs, chosen, len(positions))]
    kept = [np.zeros((0, 2), np.int64)]
    kept += [
        np.sort(cluster, axis=1)
        for cluster in _clusters(walls, len(positions))
        if _apart(positions, bonds, cluster, spacing)
    ]
    return np.concatenate(kept)


def _beside(
    positions: Float64[np.ndarray, "particles 3"], points: Float64[np.ndarray, "_ 3"], reach: float
) -> Bool[np.ndarray, " particles"]:
    """Particles within `reach` [m] of any of the points."""
    if len(points) == 0:
        return np.zeros(len(positions), dtype=bool)
    distance, _ = KDTree(points).query(positions, distance_upper_bound=reach)
    return np.isfinite(distance)


def _joined(
    bonds: Int64[np.ndarray, "bonds 2"],
    pairs: Int64[np.ndarray, "pairs 2"],
    chosen: Int64[np.ndarray, " chosen"],
    count: int,
) -> Bool[np.ndarray, " pairs"]:
    """Whether at most `HOPS` bonds lead from one end of each pair to the other."""
    graph = adjacency(bonds, count)
    graph.setdiag(1)
    step = graph[chosen]
    for _ in range(HOPS - 1):
        step = step @ graph
        step.data[:] = 1
    row = np.searchsorted(chosen, pairs[:, 0])
    return np.asarray(step[row, pairs[:, 1]]).ravel() > 0


def _apart(
    positions: Float64[np.ndarray, "particles 3"],
    bonds: Int64[np.ndarray, "bonds 2"],
    cluster: Int64[np.ndarray, "walls 2"],
    spacing: float,
) -> bool:
    """Whether the two sides are separate pieces around any part of a wall.

    If they join everywhere nearby, the wall is a notch: dough wrapped around an edge of a finger.
    """
    link = LINK * spacing
    for rows in chunks(positions, cluster, longest=np.inf, link=link, length=CHUNK):
        if len(rows) < FEWEST_PAIRS:
            continue
        core = np.unique(cluster[rows])
        inside = _beside(positions, positions[core], LOCAL)
        piece = connected(bonds[inside[bonds].all(axis=1)], len(positions))
        if (piece[cluster[rows, 0]] != piece[cluster[rows, 1]]).mean() >= 0.5:
            return True
    return False


def _clusters(walls: Int64[np.ndarray, "walls 2"], count: int) -> list[Int64[np.ndarray, "_ 2"]]:
    """Wall pairs that hang together in sufficient number."""
    if len(walls) == 0:
        return []
    part = connected(walls, count)[walls[:, 0]]
    sizes = np.bincount(part)
    return [walls[part == k] for k in np.flatnonzero(sizes >= FEWEST_PAIRS)]
