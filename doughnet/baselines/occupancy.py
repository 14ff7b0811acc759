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
    ndimage, measure = train_package("scipy.ndimage"), train_package("skimage.measure")
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
        genera.append(1 - int(measure.euler_number(solid, connectivity=3)))
    return labels, genera
