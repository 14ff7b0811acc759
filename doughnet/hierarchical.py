"""Decoding a whole grid from coarse to fine: only where labels change is every node evaluated.

The coarse nodes are evaluated first. A cell between eight of them is open if these differ, or if it
touches a cell where they do; nodes at half the spacing are evaluated in open cells and take their
neighbours' label elsewhere. Dough that no coarse node meets is lost, so the first stride must stay
below its thickness.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from doughnet.lattice import Lattice

__all__ = ["decode_all", "decode_labels"]

CHUNK = 16384  # points evaluated at once: their weights over the latents stay in the cache
Decoder = Callable[[Float[Tensor, "1 S 3"]], Float[Tensor, "1 S classes"]]
Labels = UInt8[Tensor, "nx ny nz"]
Finer = UInt8[Tensor, "mx my mz"]


def decode_labels(
    decoder: Decoder, lattice: Lattice, *, strides: tuple[int, ...] = (4, 2)
) -> Labels:
    """Most likely mask at every node of a lattice, coarse to fine.

    Args:
        decoder: logits at points [m], for example a `FoldedDecoder` of one shape.
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
    labels = decode_all(decoder, whole, stride=top)
    for stride in (*strides[1:], 1):
        labels = _refined(decoder, whole, labels, stride)
    nx, ny, nz = lattice.shape
    return labels[:nx, :ny, :nz]


def decode_all(decoder: Decoder, lattice: Lattice, *, stride: int = 1) -> Labels:
    """Most likely mask at every `stride`-th node, each evaluated."""
    nx, ny, nz = ((n - 1) // stride + 1 for n in lattice.shape)
    flat = torch.arange(nx * ny * nz)
    return _evaluate(decoder, lattice, flat, stride).reshape(nx, ny, nz)


def _refined(decoder: Decoder, lattice: Lattice, coarse: Labels, stride: int) -> Finer:
    """Labels at half the spacing of `coarse`."""
    open_cells = _mixed(coarse)
    if stride > 1:  # detail between coarse nodes is up to a whole cell away from where it shows
        open_cells = _grown(open_cells)
    labels, unsure = _doubled(coarse), _around(open_cells)
    unsure[::2, ::2, ::2] = False  # known from the coarse level
    flat = unsure.flatten().nonzero()[:, 0]
    labels.view(-1)[flat] = _evaluate(decoder, lattice, flat, stride)
    return labels


def _mixed(labels: Labels) -> Bool[Tensor, "cx cy cz"]:
    """Cells whose eight corners do not all have one label."""
    low = high = labels
    for axis in range(3):
        count = labels.shape[axis] - 1
        low = torch.minimum(low.narrow(axis, 0, count), low.narrow(axis, 1, count))
        high = torch.maximum(high.narrow(axis, 0, count), high.narrow(axis, 1, count))
    return low != high


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
            count = 2 * (cells.shape[axis] - 1) + 1
            part = nodes.narrow(axis, start, count)
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


def _evaluate(
    decoder: Decoder, lattice: Lattice, flat: Int64[Tensor, " nodes"], stride: int
) -> UInt8[Tensor, " nodes"]:
    labels = [
        decoder(lattice.points(part, stride=stride)[None])[0].argmax(dim=-1).to(torch.uint8)
        for part in flat.split(CHUNK)
    ]
    return torch.cat(labels) if labels else flat.to(torch.uint8)
