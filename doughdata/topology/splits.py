"""Split candidates: necks of dough between the fingers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.spatial import KDTree

from doughdata.topology.bonds import BondGraph
from doughdata.topology.crops import SIDE_BOND, Crop, in_box
from doughdata.topology.fingers import Gripper
from doughdata.topology.pairs import connected

__all__ = ["Neck", "compression", "split_necks"]

SMALLEST_SIDE = 15  # particles
BESIDE = 0.006  # [m], of dough beside a neck over which its thickness is measured
TOUCH = 1.0  # [spacings], a particle this close to a finger touches it
LATERAL = 0.5  # [spacings], by which a neck reaches beyond the contact faces
SMALLEST_CROP = 0.008  # [m]
SHRINK = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Neck:
    """Bonded particles between the fingers with dough on both sides along the lateral axis."""

    core: Int64[np.ndarray, " core"]
    first: Int64[np.ndarray, " first"]  # on the negative lateral side
    second: Int64[np.ndarray, " second"]
    around: Int64[np.ndarray, " crop"]
    opening: float  # [m], gap between the fingers where the neck is thinnest
    centre: Float64[np.ndarray, " 3"]  # [m]


def split_necks(graph: BondGraph, gripper: Gripper, *, radius: float, gate: float) -> list[Neck]:
    """Necks thinner than `gate` times the dough beside them, within a crop of `radius` [m]."""
    x, s = graph.positions, graph.spacing
    region, opening = _between_fingers(x, s, gripper)
    if len(region) == 0:
        return []
    bonds = graph.bonded_pairs(SIDE_BOND)
    piece = _pieces_of(graph.count, bonds, region)
    sizes = np.bincount(piece)
    loose = region[sizes[piece] < SMALLEST_SIDE]  # scraps that would bridge the neck
    along, across = x @ gripper.closing, x @ gripper.lateral
    necks = []
    for number in np.flatnonzero(sizes):
        core = region[piece == number]
        if opening >= gate * np.ptp(along[in_box(x, x[core], radius)]):
            continue  # no dough beside it can be thick enough
        neck = _neck(graph, bonds, across, core, np.union1d(core, loose), opening, radius)
        if neck is not None and opening < gate * _thickness(along, across, neck):
            necks.append(neck)
    return sorted(necks, key=lambda neck: tuple(neck.centre))


def _pieces_of(
    count: int, bonds: Int64[np.ndarray, "bonds 2"], members: Int64[np.ndarray, " members"]
) -> Int32[np.ndarray, " members"]:
    """Bonded piece of each member among `count` particles when all others are taken away."""
    place = np.full(count, -1)
    place[members] = np.arange(len(members))
    ends = np.stack([place.take(bonds[:, 0]), place.take(bonds[:, 1])], axis=1)
    kept = np.flatnonzero((ends[:, 0] >= 0) & (ends[:, 1] >= 0))
    return connected(ends.take(kept, axis=0), len(members))


def _between_fingers(
    x: Float64[np.ndarray, "particles 3"], s: float, gripper: Gripper
) -> tuple[Int64[np.ndarray, " region"], float]:
    """Particles in the gap when both fingers touch dough, and the gap there [m].

    Between two faces the distances to both fingers add up to the gap; elsewhere to more.
    """
    middle = gripper.position.mean(axis=0)
    half = np.linalg.norm(gripper.position[0] - gripper.position[1]) / 2
    along = np.abs((x - middle) @ gripper.closing)
    close = np.flatnonzero(along < half + s)
    none = np.zeros(0, np.int64)
    if len(close) == 0:
        return none, 0.0
    distance = gripper.distances(x[close])
    total = np.maximum(distance, 0.0).sum(axis=0)
    touching = (distance < TOUCH * s).sum(axis=1)
    # Between nearly closed fingers there may be no particle left to touch them.
    if 2 * half > 2 * s and (touching < 1).any():
        return none, 0.0
    gap = float(np.clip(total.min(), 0.0, None))
    return close[total < gap + LATERAL * s], gap


def _neck(
    graph: BondGraph,
    bonds: Int64[np.ndarray, "bonds 2"],
    across: Float64[np.ndarray, " particles"],
    core: Int64[np.ndarray, " core"],
    removed: Int64[np.ndarray, " removed"],
    opening: float,
    radius: float,
) -> Neck | None:
    """The neck of one cluster if dough lies on both its sides, apart once `removed` is gone."""
    crop = Crop(graph.positions, bonds, core, radius)
    place = across[crop.indices] - across[core].mean()
    beside = _bonded_to(crop.bonds, crop.place[core], len(place))
    while radius >= SMALLEST_CROP:
        piece = crop.pieces(radius, leave_out=removed)
        rest = piece >= 0
        size = np.bincount(piece[rest], minlength=len(piece))
        middle = np.bincount(piece[rest], place[rest], minlength=len(piece)) / np.maximum(size, 1)
        held = np.bincount(piece[rest & beside], minlength=len(piece)) > 0
        side = np.where(held & (size >= SMALLEST_SIDE), np.where(middle < 0, 1, 2), 0)
        own = np.where(rest, side[piece], 0)
        if (own == 1).any() and (own == 2).any():
            return Neck(
                core=core,
                first=crop.indices[own == 1],
                second=crop.indices[own == 2],
                around=crop.indices[crop.distance <= radius],
                opening=opening,
                centre=graph.positions[core].mean(axis=0),
            )
        radius *= SHRINK
    return None


def compression(
    core: Float64[np.ndarray, "core 3"], spacing: float, gripper: Gripper, opening: float
) -> float:
    """How many times denser than at rest the particles [m] between the fingers are; at least 1.

    Between nearly closed fingers a simulation piles particles up in less room than they stand
    for; the room is counted in small cells.
    """
    s = spacing
    axes = np.stack([gripper.closing, gripper.lateral, [0.0, 0.0, 1.0]])
    local = core @ axes.T
    step = np.array([max(opening, 0.1 * s) / 4, s / 3, s / 3])
    low, high = local.min(axis=0) - s, local.max(axis=0) + s
    ticks = [np.arange(a + d / 2, b, d) for a, b, d in zip(low, high, step, strict=True)]
    cells = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3) @ axes
    distance = gripper.distances(cells)
    cells = cells[(distance > 0).all(axis=0) & (distance.sum(axis=0) < opening + LATERAL * s)]
    near, _ = KDTree(core).query(cells, distance_upper_bound=0.8 * s)
    room = np.isfinite(near).sum() * float(step.prod())
    return max(1.0, len(core) * s**3 / room) if room else 1.0


def _bonded_to(
    bonds: Int64[np.ndarray, "bonds 2"], core: Int64[np.ndarray, " core"], count: int
) -> Bool[np.ndarray, " particles"]:
    """Particles with a bond to the core."""
    inner = np.zeros(count, dtype=bool)
    inner[core] = True
    touched = np.zeros(count, dtype=bool)
    touched[bonds[:, 0][inner[bonds[:, 1]]]] = True
    touched[bonds[:, 1][inner[bonds[:, 0]]]] = True
    return touched & ~inner


def _thickness(
    along: Float64[np.ndarray, " particles"], across: Float64[np.ndarray, " particles"], neck: Neck
) -> float:
    """Thickness [m] along the closing axis of the thinner side, next to the neck."""
    middle = across[neck.core].mean()
    thickness = []
    for side in (neck.first, neck.second):
        away = np.abs(across[side] - middle)
        beside = along[side[away < away.min() + BESIDE]]
        low, high = np.percentile(beside, (3, 97))
        thickness.append(float(high - low))
    return min(thickness)
