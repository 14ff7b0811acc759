"""The lattice on which shapes are decoded and compared: all multiples of a spacing in a box."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64, UInt8
from torch import Tensor

from doughschemas import NO_COMPONENT, BadInputError, LabelGrid

__all__ = ["WORKSPACE", "Lattice", "on_lattice", "workspace_lattice"]

# Box [m] in which bodies stay, and above it what dough reaches.
WORKSPACE = ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.06))
MILLIMETRE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice:
    """Node (i, j, k) lies at spacing (first + (i, j, k)) [m], world."""

    first: tuple[int, int, int]
    shape: tuple[int, int, int]
    spacing: float = MILLIMETRE  # [m]

    @property
    def count(self) -> int:
        """Nodes."""
        return int(np.prod(self.shape))

    @property
    def origin(self) -> Float64[np.ndarray, " 3"]:
        """Position of the first node [m]."""
        return self.spacing * np.array(self.first, float)

    def along(self, axis: int) -> Float[Tensor, " nodes"]:
        """Coordinates [m] of the nodes along an axis."""
        index = self.first[axis] + torch.arange(self.shape[axis])
        return (self.spacing * index.double()).float()

    def points(self, flat: Int64[Tensor, " nodes"], *, stride: int = 1) -> Float[Tensor, "nodes 3"]:
        """Positions [m] of nodes by their flat index among every `stride`-th node."""
        shape = tuple((n - 1) // stride + 1 for n in self.shape)
        index = torch.stack(torch.unravel_index(flat, shape), dim=-1)
        first = torch.tensor(self.first, device=flat.device)
        return (self.spacing * (first + stride * index).double()).float()


def workspace_lattice(*, spacing: float = MILLIMETRE) -> Lattice:
    """The lattice over the whole workspace, the table's plane included."""
    low, high = (np.array(corner) for corner in WORKSPACE)
    first = np.ceil(low / spacing - 1e-6).astype(int)
    last = np.floor(high / spacing + 1e-6).astype(int)
    return Lattice(first=_triple(first), shape=_triple(last - first + 1), spacing=spacing)


def on_lattice(grid: LabelGrid, lattice: Lattice) -> UInt8[np.ndarray, "nx ny nz"]:
    """A label grid at the nodes of a lattice, NO_COMPONENT where it has none.

    Raises:
        BadInputError: the grid's nodes are no nodes of the lattice.
    """
    offset = grid.origin / lattice.spacing - np.array(lattice.first)
    start = np.rint(offset).astype(int)
    if abs(grid.spacing / lattice.spacing - 1) > 1e-6 or np.abs(offset - start).max() > 1e-3:
        raise BadInputError(
            f"labels are needed on multiples of {lattice.spacing * 1e3:g} mm, got a grid of "
            f"{grid.spacing * 1e3:g} mm from {grid.origin}; mesh the dataset with that spacing"
        )
    out = np.full(lattice.shape, NO_COMPONENT, np.uint8)
    low = np.maximum(start, 0)
    high = np.minimum(start + grid.labels.shape, lattice.shape)
    if np.all(low < high):
        here = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        there = tuple(slice(a - s, b - s) for a, b, s in zip(low, high, start, strict=True))
        out[here] = grid.labels[there]
    return out


def _triple(values: Any) -> tuple[int, int, int]:
    a, b, c = (int(value) for value in values)
    return a, b, c
