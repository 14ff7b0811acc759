"""Merge candidates: where near surfaces may have become one piece."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64

from doughdata.topology.bonds import BondGraph
from doughdata.topology.crops import SIDE_BOND, Crop, chunks
from doughdata.topology.decisions import Question
from doughdata.topology.pairs import encode, lengths

__all__ = ["Patch", "merge_patches"]

FEWEST_PAIRS = 8  # a patch of fewer contact pairs is not looked at
SMALLEST_SIDE = 15  # particles
SMALLEST_CROP = 0.005  # [m]
SHRINK = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """Contact pairs between two locally separate sides, lower side first."""

    pairs: Int64[np.ndarray, "pairs 2"]  # column 0 in side 1, column 1 in side 2
    first: Int64[np.ndarray, " first"]  # particles of side 1 in the crop
    second: Int64[np.ndarray, " second"]
    core: Int64[np.ndarray, " core"]  # particles of the patch
    normal: Float64[np.ndarray, " 3"]  # from side 1 to side 2
    centre: Float64[np.ndarray, " 3"]  # [m]
    gap: float  # [spacings], mean of the closest tenth of the pairs


def merge_patches(
    graph: BondGraph,
    *,
    gap: float,
    nearest: float,
    link: float,
    length: float,
    radius: float,
    seam_gap: float,
    settled: Callable[[Question], bool],
) -> list[Patch]:
    """Patches that may have merged. Patches whose sides already join close by are settled at once.

    A patch is made up of contacts up to `gap` spacings long; one without any below `nearest` is
    left out, and so is one that `settled` says was asked about.

    A patch that only extends a merged seam (its sides are one piece even within 5 mm) is bonded
    where the local gap is below `seam_gap` spacings; no pull can part it from its seam.
    """
    open_rows = np.flatnonzero(graph.contact & (graph.lengths < gap * graph.spacing))
    pairs = graph.pairs[open_rows[~graph.locked(open_rows)]]
    x, s = graph.positions, graph.spacing
    found: list[Patch] = []
    parts = chunks(x, pairs, longest=gap * s, link=link * s, length=length)
    parts = [pairs[rows] for rows in parts if len(rows) >= FEWEST_PAIRS]
    parts = [part for part in parts if lengths(x, part).min() < nearest * s]
    parts = [part for part in parts if not settled(_about(x, part, s))]
    if not parts:
        return found
    bonds = graph.bonded_pairs(SIDE_BOND)
    for part in parts:
        piece = _split_sides(graph, bonds, part, radius)
        ends = piece[part]
        apart = ends[:, 0] != ends[:, 1]
        if apart.sum() < FEWEST_PAIRS:
            _extend_seam(graph, part, seam_gap)
            continue
        found += _patches(graph, part[apart], piece)
    return [patch for patch in found if patch.gap < nearest]


def _split_sides(
    graph: BondGraph,
    bonds: Int64[np.ndarray, "bonds 2"],
    pairs: Int64[np.ndarray, "pairs 2"],
    radius: float,
) -> Int32[np.ndarray, " particles"]:
    """Bonded pieces around a patch (-1 elsewhere); the crop shrinks until the two sides differ."""
    around = Crop(graph.positions, bonds, np.unique(pairs), radius)
    ends = around.place[pairs]
    while True:
        piece = around.pieces(radius)
        # Pair by pair: which end comes first is a matter of how the particles are numbered.
        mixed = (piece[ends[:, 0]] == piece[ends[:, 1]]).any()
        if not mixed or radius <= SMALLEST_CROP:
            break
        radius *= SHRINK
    found = np.full(graph.count, -1, np.int32)
    found[around.indices] = piece
    return found


def _extend_seam(graph: BondGraph, pairs: Int64[np.ndarray, "pairs 2"], seam_gap: float) -> None:
    distance = lengths(graph.positions, pairs) / graph.spacing
    nearest = np.full(graph.count, np.inf)
    np.minimum.at(nearest, pairs[:, 0], distance)
    np.minimum.at(nearest, pairs[:, 1], distance)
    closed = (nearest[pairs] < seam_gap).all(axis=1)
    if closed.any():
        graph.join(encode(pairs[closed], graph.count))


def _patches(
    graph: BondGraph, pairs: Int64[np.ndarray, "pairs 2"], piece: Int32[np.ndarray, " particles"]
) -> list[Patch]:
    """One patch for each pair of pieces that meet."""
    ends = np.sort(piece[pairs], axis=1)
    found = []
    for low, high in np.unique(ends, axis=0):
        own = (ends == (low, high)).all(axis=1)
        first, second = np.flatnonzero(piece == low), np.flatnonzero(piece == high)
        if own.sum() < FEWEST_PAIRS or min(len(first), len(second)) < SMALLEST_SIDE:
            continue
        found.append(_patch(graph, pairs[own], piece[pairs[own][:, 0]] == high, first, second))
    return found


def _patch(
    graph: BondGraph,
    pairs: Int64[np.ndarray, "pairs 2"],
    flipped: Bool[np.ndarray, " pairs"],
    first: Int64[np.ndarray, " first"],
    second: Int64[np.ndarray, " second"],
) -> Patch:
    x = graph.positions
    pairs = np.where(flipped[:, None], pairs[:, ::-1], pairs)
    step = x[pairs[:, 1]] - x[pairs[:, 0]]
    distance = np.linalg.norm(step, axis=1)
    normal = (step / distance[:, None] ** 2).sum(axis=0)  # close pairs count most
    return Patch(
        pairs=pairs,
        first=first,
        second=second,
        core=np.unique(pairs),
        normal=normal / np.linalg.norm(normal),
        centre=_centre(x, pairs),
        gap=_gap(distance) / graph.spacing,
    )


def _about(
    positions: Float64[np.ndarray, "particles 3"], pairs: Int64[np.ndarray, "pairs 2"], s: float
) -> Question:
    gap = _gap(lengths(positions, pairs)) / s
    return Question(kind="merge", centre=_centre(positions, pairs), size=len(pairs), gap=gap)


def _centre(
    positions: Float64[np.ndarray, "particles 3"], pairs: Int64[np.ndarray, "pairs 2"]
) -> Float64[np.ndarray, " 3"]:
    return positions[pairs].mean(axis=(0, 1))


def _gap(distance: Float64[np.ndarray, " pairs"]) -> float:
    """Mean of the closest tenth."""
    return float(np.sort(distance)[: max(FEWEST_PAIRS, len(distance) // 10)].mean())
