"""Neighbourhoods: the particles around a patch, their sides, and patches cut to testable size."""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.spatial import KDTree

from doughdata.topology.pairs import connected, lengths

__all__ = ["SIDE_BOND", "Crop", "cells_along", "chunks", "in_box"]

SIDE_BOND = 2.0  # [spacings]; longer bonds do not hold a side together


def in_box(
    positions: Float64[np.ndarray, "particles 3"],
    points: Float64[np.ndarray, "points 3"],
    margin: float,
) -> Bool[np.ndarray, " particles"]:
    """Which particles lie in the box of some points, widened by `margin` [m]."""
    inside = np.ones(len(positions), dtype=bool)
    for along, own in zip(positions.T, points.T, strict=True):
        inside &= (along >= own.min() - margin) & (along <= own.max() + margin)
    return inside


class Crop:
    """The particles around a core, nearest first asked, and the short bonds among them."""

    def __init__(
        self,
        positions: Float64[np.ndarray, "particles 3"],
        bonds: Int64[np.ndarray, "bonds 2"],
        core: Int64[np.ndarray, " core"],
        radius: float,
    ) -> None:
        """Collect what lies within `radius` [m] of any core particle.

        `bonds` are the bonded pairs short enough to hold a side (`SIDE_BOND`).
        """
        inside = in_box(positions, positions[core], radius)
        inside[core] = False
        box = np.flatnonzero(inside)
        away, _ = KDTree(positions[core]).query(positions[box], distance_upper_bound=radius)
        indices = np.concatenate([core, box])
        distance = np.concatenate([np.zeros(len(core)), away])
        near = np.flatnonzero(np.isfinite(distance))
        order = np.argsort(indices[near])
        self.indices = indices[near][order]  # sorted
        self.distance = distance[near][order]  # [m], to the core
        self.place = np.full(len(positions), -1)
        self.place[self.indices] = np.arange(len(near))
        ends = np.stack([self.place.take(bonds[:, 0]), self.place.take(bonds[:, 1])], axis=1)
        self.bonds = ends.take(np.flatnonzero((ends[:, 0] >= 0) & (ends[:, 1] >= 0)), axis=0)

    def pieces(
        self, radius: float, *, leave_out: Int64[np.ndarray, " _"] | None = None
    ) -> Int32[np.ndarray, " crop"]:
        """Bonded piece of every particle within `radius` [m] of the core; -1 beyond it.

        Particles `leave_out` are taken away first.
        """
        member = self.distance <= radius
        if leave_out is not None:
            gone = self.place[leave_out]
            member[gone[gone >= 0]] = False
        kept = member.take(self.bonds[:, 0]) & member.take(self.bonds[:, 1])
        piece = connected(self.bonds.take(np.flatnonzero(kept), axis=0), len(member))
        return np.where(member, piece, -1).astype(np.int32)


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
