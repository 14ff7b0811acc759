"""The static check of a predicted volume: what hangs together is one component."""

import numpy as np
from jaxtyping import Bool, Int64

from doughnet.extras import train_package

__all__ = ["static_components"]

SMALLEST = 800  # nodes at 1 mm: 0.8 cm3, the crumbs of the simulation's checks


def static_components(
    dough: Bool[np.ndarray, "nx ny nz"], *, smallest: int = SMALLEST
) -> tuple[Int64[np.ndarray, "nx ny nz"], list[int]]:
    """Components of the marked nodes and the genus of each, from its Euler characteristic.

    Nodes that share a face, an edge or a corner are connected. Hollows are filled first, so that
    handles are all that is left: genus = 1 - characteristic. Pieces below `smallest` nodes are no
    dough, unless there are no others.

    Returns:
        Labels, largest component first, empty nodes having the number of components; the genera.
    """
    ndimage = train_package("scipy.ndimage")
    pieces, count = ndimage.label(dough, np.ones((3, 3, 3)))
    sizes = np.bincount(pieces.reshape(-1), minlength=count + 1)[1:]
    order = np.argsort(-sizes, kind="stable")
    order = order[sizes[order] >= min(smallest, sizes.max(initial=0))]
    labels = np.full(dough.shape, len(order), np.int64)
    genera = []
    boxes = ndimage.find_objects(pieces)
    for name, piece in enumerate(order.tolist()):
        box = boxes[piece]
        own = pieces[box] == piece + 1
        labels[box][own] = name
        solid = ndimage.binary_fill_holes(np.pad(own, 1))
        genera.append(1 - euler_characteristic(solid))
    return labels, genera


def euler_characteristic(solid: Bool[np.ndarray, "nx ny nz"]) -> int:
    """Of the union of closed unit cubes at the marked nodes, whose border is left empty.

    Vertices - edges + faces - cubes of the cell complex, each counted once.
    """
    cells = 0
    for axes in np.ndindex(2, 2, 2):  # along which axes a cell of the complex is a point
        part = solid
        for axis, point in enumerate(axes):
            if point:
                low = np.take(part, range(part.shape[axis] - 1), axis)
                part = low | np.take(part, range(1, part.shape[axis]), axis)
        cells += (-1) ** (3 - sum(axes)) * int(part.sum())
    return cells
