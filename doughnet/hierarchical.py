"""Decoding a whole grid from coarse to fine: only where labels change is every node evaluated.

The coarse nodes are evaluated first. A cell between eight of them is open if these differ, or if it
touches a cell where they do; nodes at half the spacing are evaluated in open cells and take their
neighbours' label elsewhere. Dough that no coarse node meets is lost, so the first stride must stay
below its thickness.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from doughnet.lattice import Lattice

__all__ = ["decode_all", "decode_labels"]

CHUNK = 8192  # nodes evaluated at once: their weights over the latents stay in the cache
Indices = Int[Tensor, "*nodes"]
AtNodes = Callable[[Indices, Indices, Indices], Float[Tensor, "*nodes classes"]]
Decoder = Callable[[Lattice], AtNodes]  # e.g. `lambda lattice: NodeDecoder(folded, lattice)`
Labels = UInt8[Tensor, "nx ny nz"]
Finer = UInt8[Tensor, "mx my mz"]
Box = tuple[slice, slice, slice]


def decode_labels(
    decoder: Decoder, lattice: Lattice, *, strides: tuple[int, ...] = (4, 2)
) -> Labels:
    """Most likely mask at every node of a lattice, coarse to fine.

    Args:
        decoder: logits at the nodes of a lattice, by their indices along x, y and z.
        lattice: where to decode; it is extended to whole coarse cells and cut again.
        strides: of the coarse levels, each twice the next; the last is 2, so that 1 follows.
    """
    top = strides[0]
    cells = tuple(-(-(n - 1) // top) for n in lattice.shape)
    whole = Lattice(
        first=lattice.first,
        shape=(cells[0] * top + 1, cells[1] * top + 1, cells[2] * top + 1),
        spacing=lattice.spacing,
    )
    at_nodes = decoder(whole)
    labels = _every(at_nodes, whole, top)
    for stride in (*strides[1:], 1):
        labels = _refined(at_nodes, labels, stride)
    nx, ny, nz = lattice.shape
    return labels[:nx, :ny, :nz]


def decode_all(decoder: Decoder, lattice: Lattice, *, stride: int = 1) -> Labels:
    """Most likely mask at every `stride`-th node, each evaluated."""
    return _every(decoder(lattice), lattice, stride)


def _every(at_nodes: AtNodes, lattice: Lattice, stride: int) -> Labels:
    x, y, z = (torch.arange(0, n, stride) for n in lattice.shape)
    slab = max(1, CHUNK // (len(y) * len(z)))
    parts = [_likeliest(at_nodes(part[:, None, None], y[:, None], z)) for part in x.split(slab)]
    return torch.cat(parts)


def _refined(at_nodes: AtNodes, coarse: Labels, stride: int) -> Finer:
    """Labels at half the spacing of `coarse`, which becomes `stride`."""
    labels, open_cells = _doubled(coarse), _mixed(coarse)
    if stride > 1:  # detail between coarse nodes is up to a whole cell away from where it shows
        open_cells = _grown(open_cells)
    if not open_cells.any():
        return labels
    box = _bounding_box(open_cells)
    unsure = _around(open_cells[box])
    unsure[::2, ::2, ::2] = False  # known from the coarse level
    local = unsure.nonzero(as_tuple=True)
    x, y, z = (index + 2 * side.start for index, side in zip(local, box, strict=True))
    for part in zip(x.split(CHUNK), y.split(CHUNK), z.split(CHUNK), strict=True):
        labels[part] = _likeliest(at_nodes(*(stride * index for index in part)))
    return labels


def _likeliest(logits: Float[Tensor, "*nodes classes"]) -> UInt8[Tensor, "*nodes"]:
    return logits.argmax(dim=-1).to(torch.uint8)


def _mixed(labels: Labels) -> Bool[Tensor, "cx cy cz"]:
    """Cells whose eight corners do not all have one label."""
    low = high = labels
    for axis in range(3):
        count = labels.shape[axis] - 1
        low = torch.minimum(low.narrow(axis, 0, count), low.narrow(axis, 1, count))
        high = torch.maximum(high.narrow(axis, 0, count), high.narrow(axis, 1, count))
    return low != high


def _bounding_box(cells: Bool[Tensor, "cx cy cz"]) -> Box:
    """The smallest box that holds all marked cells, of which there is one."""
    sides = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        marked = cells.amax(dim=others).nonzero()[:, 0].tolist()
        sides.append(slice(marked[0], marked[-1] + 1))
    return sides[0], sides[1], sides[2]


def _grown(cells: Bool[Tensor, "cx cy cz"]) -> Bool[Tensor, "cx cy cz"]:
    """Marked cells and all that touch one."""
    for axis in range(3):
        grown, count = cells.clone(), cells.shape[axis] - 1
        grown.narrow(axis, 0, count).logical_or_(cells.narrow(axis, 1, count))
        grown.narrow(axis, 1, count).logical_or_(cells.narrow(axis, 0, count))
        cells = grown
    return cells


def _around(cells: Bool[Tensor, "cx cy cz"]) -> Bool[Tensor, "mx my mz"]:
    """Nodes at half the spacing that lie in a marked cell or on its border."""
    for axis in range(3):
        shape = list(cells.shape)
        shape[axis] = 2 * shape[axis] + 1
        nodes = torch.zeros(shape, dtype=torch.bool)
        for start in range(3):  # a cell has three such nodes along an axis, and shares two
            part = nodes.narrow(axis, start, 2 * cells.shape[axis] - 1)
            index = [slice(None)] * 3
            index[axis] = slice(None, None, 2)
            part[tuple(index)] |= cells
        cells = nodes
    return cells


def _doubled(labels: Labels) -> Finer:
    """Labels at half the spacing, a new node taking that of the node before it."""
    for axis in range(3):
        labels = labels.repeat_interleave(2, dim=axis).narrow(axis, 0, 2 * labels.shape[axis] - 1)
    return labels.contiguous()
