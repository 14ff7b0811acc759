"""Weak bridges: where two thick parts of one piece hang together by a few particles.

A finger drags particles along, leaves scraps beside it and pulls threads; bonds to such particles
lead from one side of a cut to the other, far from any neck that a pull test looks at. The thick
parts are the particles with many short bonds; a bridge is what is left between two of them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8
from scipy.spatial import KDTree

from doughdata.topology.bonds import BondGraph
from doughdata.topology.crops import SIDE_BOND
from doughdata.topology.pairs import connected
from doughdata.topology.pulls import most_paths

__all__ = ["Bridge", "weak_bridges"]

FEWEST_BONDS = 10  # short ones of a particle in a thick part; a chain two wide has up to 9 each


@dataclass(frozen=True, slots=True, kw_only=True)
class Bridge:
    """Few particles between two thick parts of one piece."""

    paths: int  # vertex-disjoint ones from part to part
    side: UInt8[np.ndarray, " particles"]  # 1 and 2 on either side, 0 elsewhere
    centre: Float64[np.ndarray, " 3"]  # [m]
    size: int  # particles of the bridge


def weak_bridges(graph: BondGraph, *, smallest: float, weakest: float) -> list[Bridge]:
    """Bridges of fewer than `weakest` disjoint paths between parts of `smallest` particles each."""
    short = graph.bonded_pairs(SIDE_BOND)
    thick = np.bincount(short.ravel(), minlength=graph.count) >= FEWEST_BONDS
    inner = short.take(np.flatnonzero(thick.take(short[:, 0]) & thick.take(short[:, 1])), axis=0)
    part = connected(inner, graph.count)
    sizes = np.bincount(part, weights=thick)
    large = np.flatnonzero(sizes >= smallest)
    if len(large) < 2:
        return []
    bonds = graph.bonded_pairs(graph.link)
    piece = connected(bonds, graph.count)
    home = piece[np.unique(part, return_index=True)[1][large]]  # the piece of each part
    found = []
    for number in np.unique(home):
        parts = large[home == number][np.argsort(sizes[large[home == number]], kind="stable")]
        rest = np.flatnonzero(piece == number)
        for k in range(len(parts) - 1):
            own = np.where(np.isin(part[rest], parts[k:]) & thick[rest], part[rest], -1)
            bridge = _bridge(graph, bonds, rest, own == parts[k], (own >= 0) & (own != parts[k]))
            if bridge.paths < weakest:
                found.append(bridge)
                rest = rest[bridge.side[rest] != 1]
    return found


def _bridge(
    graph: BondGraph,
    bonds: Int64[np.ndarray, "bonds 2"],
    members: Int64[np.ndarray, " members"],
    first: Bool[np.ndarray, " members"],
    second: Bool[np.ndarray, " members"],
) -> Bridge:
    """What lies between two sets of a piece's members."""
    place = np.full(graph.count, -1)
    place[members] = np.arange(len(members))
    ends = np.stack([place.take(bonds[:, 0]), place.take(bonds[:, 1])], axis=1)
    ends = ends.take(np.flatnonzero((ends >= 0).all(axis=1)), axis=0)
    x = graph.positions[members]
    away = [KDTree(x[own]).query(x)[0] for own in (first, second)]
    side = np.zeros(graph.count, np.uint8)
    side[members] = np.where(first | (~second & (away[0] <= away[1])), 1, 2)
    across = np.unique(ends[side[members][ends[:, 0]] != side[members][ends[:, 1]]])
    return Bridge(
        paths=most_paths(ends, first, second),
        side=side,
        centre=x[across].mean(axis=0) if len(across) else x.mean(axis=0),
        size=len(across),
    )
