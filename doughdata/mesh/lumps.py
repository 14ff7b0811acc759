"""One closed shell a component: lumps bridged or dropped, hollows filled, nothing left empty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from doughdata.registry import require_package
from doughschemas import NO_COMPONENT

__all__ = ["Lumps", "bridge_lumps", "drop_lumps", "fill_cavities", "find_lumps", "seed_missing"]

BRIDGE_RADIUS = 1.2  # [cells]; above sqrt(3)/2 nodes along a segment are connected by edges


@dataclass(frozen=True, slots=True, kw_only=True)
class Lumps:
    """Connected inside nodes; lump 0 is the outside."""

    numbers: Int[np.ndarray, "nx ny nz"]  # lump of every node
    owner: UInt8[np.ndarray, " lumps"]  # component of each
    counts: Bool[np.ndarray, " lumps"]  # whether it is large enough to be kept


def find_lumps(labels: UInt8[np.ndarray, "nx ny nz"], *, share: float) -> Lumps:
    """Lumps of a labelled solid; those count that hold `share` of the largest of their label."""
    ndimage = require_package("scipy.ndimage", extra="sim")
    inside = labels != NO_COMPONENT
    numbers, count = ndimage.label(inside)
    size = np.bincount(numbers.reshape(-1), minlength=count + 1)
    owner = np.full(count + 1, NO_COMPONENT, np.uint8)
    owner[numbers[inside]] = labels[inside]
    largest = np.zeros(NO_COMPONENT + 1)
    np.maximum.at(largest, owner[1:], size[1:])
    counts = size >= share * largest[owner]
    counts[0] = False
    return Lumps(numbers=numbers, owner=owner, counts=counts)


def drop_lumps(
    field: Float32[np.ndarray, "nx ny nz"], labels: UInt8[np.ndarray, "nx ny nz"], lumps: Lumps
) -> None:
    """Take away, in place, the lumps that do not count."""
    if lumps.counts[1:].all():
        return
    gone = ~lumps.counts
    gone[0] = False
    drop = gone[lumps.numbers]
    labels[drop] = NO_COMPONENT
    field[drop] = 1.0


def bridge_lumps(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    lumps: Lumps,
    *,
    reach: float,
) -> bool:
    """Join, in place, lumps of one label by thin bars where they are nearest.

    The bars form a tree, so they close no loop. They go around nothing: a bar may be cut by another
    component, after which the lumps stay apart.

    Args:
        field: [cells], negative inside.
        labels: component of each inside node.
        lumps: of the labels; those that do not count are ignored.
        reach: longest bar [cells].

    Returns:
        Whether a bar was placed.
    """
    spatial = require_package("scipy.spatial", extra="sim")
    placed = False
    for label in np.unique(lumps.owner[1:]):
        parts = np.flatnonzero((lumps.owner == label) & lumps.counts)
        if len(parts) < 2:
            continue
        nodes = {int(part): np.argwhere(lumps.numbers == part) for part in parts}
        joined = nodes.pop(max(nodes, key=lambda part: len(nodes[part])))
        while nodes:
            tree = spatial.cKDTree(joined)
            near = {part: tree.query(points) for part, points in nodes.items()}
            part = min(near, key=lambda p: near[p][0].min())
            distance, index = near[part]
            points = nodes.pop(part)
            best = int(distance.argmin())
            if distance[best] <= reach:
                _place_bar(field, labels, points[best], joined[index[best]], int(label))
                placed = True
            joined = np.concatenate([joined, points])
    return placed


def _place_bar(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    start: Int[np.ndarray, " 3"],
    end: Int[np.ndarray, " 3"],
    label: int,
) -> None:
    """Label the free nodes around a segment."""
    low, high = np.minimum(start, end) - 2, np.maximum(start, end) + 3
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    offset = np.moveaxis(np.indices(tuple(high - low)), 0, -1) + low - start
    along = (end - start) / max(float((end - start) @ (end - start)), 1.0)
    where = np.clip(offset @ along, 0.0, 1.0)[..., None] * (end - start)
    value = np.linalg.norm(offset - where, axis=-1) - BRIDGE_RADIUS
    free = (labels[box] == NO_COMPONENT) & (value < 0.0)
    labels[box][free] = label
    field[box][free] = value[free]


def fill_cavities(
    field: Float32[np.ndarray, "nx ny nz"], labels: UInt8[np.ndarray, "nx ny nz"]
) -> None:
    """Fill, in place, every hollow that a single component encloses."""
    ndimage = require_package("scipy.ndimage", extra="sim")
    hollows, count = ndimage.label(labels == NO_COMPONENT)
    if count < 2:
        return
    exterior = hollows[0, 0, 0]
    for number, box in enumerate(ndimage.find_objects(hollows), start=1):
        if number == exterior or box is None:
            continue
        wide = tuple(slice(side.start - 1, side.stop + 1) for side in box)
        hollow = hollows[wide] == number
        rim = ndimage.binary_dilation(hollow, np.ones((3, 3, 3), bool)) & ~hollow
        owners = np.unique(labels[wide][rim])
        owners = owners[owners != NO_COMPONENT]
        if len(owners) == 1:
            labels[wide][hollow] = owners[0]
            field[wide][hollow] = -1.0


def seed_missing(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    clouds: list[Float[np.ndarray, "_ 3"]],
) -> None:
    """Give, in place, a component that lost all its nodes the free node nearest to its middle.

    A lone node whose 26 neighbours are outside keeps the set well-composed.
    """
    ndimage = require_package("scipy.ndimage", extra="sim")
    present = np.unique(labels)
    for label, cloud in enumerate(clouds):
        if not len(cloud) or label in present:
            continue
        taken = ndimage.binary_dilation(labels != NO_COMPONENT, np.ones((3, 3, 3), bool))
        free = np.argwhere(~taken[2:-2, 2:-2, 2:-2]) + 2
        centre = cloud[((cloud - cloud.mean(axis=0)) ** 2).sum(axis=1).argmin()]
        node = tuple(free[((free - centre) ** 2).sum(axis=1).argmin()])
        labels[node] = label
        field[node] = -0.5
