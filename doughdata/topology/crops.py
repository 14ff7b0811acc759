"""Neighbourhoods: the particles around a patch, their sides, and patches cut to testable size."""

import numpy as np
from jaxtyping import Float64, Int32, Int64
from scipy.spatial import KDTree

from doughdata.topology.bonds import BondGraph
from doughdata.topology.pairs import connected, lengths

__all__ = ["SIDE_BOND", "cells_along", "chunks", "crop", "sides"]

SIDE_BOND = 2.0  # [spacings]; longer bonds do not hold a side together


def crop(
    positions: Float64[np.ndarray, "particles 3"], core: Int64[np.ndarray, " core"], radius: float
) -> Int64[np.ndarray, " crop"]:
    """Indices of the particles within `radius` [m] of any core particle."""
    low = positions[core].min(axis=0) - radius
    high = positions[core].max(axis=0) + radius
    box = np.flatnonzero(((positions >= low) & (positions <= high)).all(axis=1))
    distance, _ = KDTree(positions[core]).query(positions[box], distance_upper_bound=radius)
    return box[np.isfinite(distance)]


def sides(
    graph: BondGraph,
    bonds: Int64[np.ndarray, "bonds 2"],
    inside: Int64[np.ndarray, " crop"],
    *,
    leave_out: Int64[np.ndarray, " _"] | None = None,
) -> Int32[np.ndarray, " particles"]:
    """Bonded piece of every particle within a crop; -1 outside it.

    `bonds` are the bonded pairs short enough to hold a side (`SIDE_BOND`).
    """
    member = np.zeros(graph.count, dtype=bool)
    member[inside] = True
    if leave_out is not None:
        member[leave_out] = False
    kept = bonds[member[bonds[:, 0]] & member[bonds[:, 1]]]
    piece = connected(kept, graph.count).astype(np.int32)
    piece[~member] = -1
    return piece


def chunks(
    positions: Float64[np.ndarray, "particles 3"],
    pairs: Int64[np.ndarray, "pairs 2"],
    *,
    longest: float,
    link: float,
    length: float,
) -> list[Int64[np.ndarray, " _"]]:
    """Cut a set of pairs into patches: rows of `pairs` per patch.

    Pairs up to `longest` [m] whose lower ends lie within `link` [m] form a cluster; a cluster is
    cut every `length` [m] along its main axis.
    """
    rows = np.flatnonzero(lengths(positions, pairs) < longest)
    if len(rows) == 0:
        return []
    used, place = np.unique(pairs[rows].ravel(), return_inverse=True)
    near = KDTree(positions[used]).query_pairs(link, output_type="ndarray")
    cluster = connected(near, len(used))[place.reshape(-1, 2)[:, 0]]
    found = []
    for number in np.unique(cluster):
        part = rows[cluster == number]
        cell = cells_along(positions[pairs[part]].mean(axis=1), length)
        found += [part[cell == k] for k in np.unique(cell)]
    return sorted(found, key=lambda part: tuple(positions[pairs[part]].mean(axis=(0, 1))))


def cells_along(
    middles: Float64[np.ndarray, "points 3"], length: float
) -> Int64[np.ndarray, " points"]:
    """Slice of each point along the longest axis of the cloud, slices about `length` [m] long."""
    centred = middles - middles.mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    along = centred @ axis
    extent = float(np.ptp(along))
    number = max(1, round(extent / length))
    return np.minimum(((along - along.min()) / max(extent, 1e-12) * number).astype(int), number - 1)
