"""The label grid: which component holds each node of a world-fixed lattice."""

import numpy as np
from jaxtyping import Float, Float32, Int

from doughdata.mesh.solid import Solid, shifted_field
from doughschemas import NO_COMPONENT, LabelGrid

__all__ = ["label_grid"]


def label_grid(
    solid: Solid, *, spacing: float, shift: Float[np.ndarray, " components"]
) -> LabelGrid:
    """Sample a solid on the lattice of all multiples of `spacing` [m] around it.

    A node belongs to a component where the trilinear field is negative. Grids of different frames
    share one lattice, so they compare node by node.

    Args:
        solid: field and labels.
        spacing: of the label grid [m].
        shift: distance [cells] by which each component's mesh lies outside field = 0.
    """
    inside = np.argwhere(solid.labels != NO_COMPONENT)
    if not len(inside):
        empty = np.full((1, 1, 1), NO_COMPONENT, np.uint8)
        return LabelGrid(labels=empty, origin=np.zeros(3), spacing=spacing)
    low = (inside.min(axis=0) - 1 + solid.origin) * solid.cell
    high = (inside.max(axis=0) + 1 + solid.origin) * solid.cell
    first = np.floor(low / spacing).astype(np.int64)
    count = np.ceil(high / spacing).astype(np.int64) - first + 1
    values = shifted_field(solid, shift)
    owner = solid.labels
    for axis in range(3):
        nodes = (first[axis] + np.arange(count[axis])) * (spacing / solid.cell)
        position = np.clip(nodes - solid.origin[axis], 0.0, solid.field.shape[axis] - 1.001)
        index = position.astype(np.intp)
        values = _interpolate(values, axis, index, (position - index).astype(np.float32))
        owner = np.minimum(owner.take(index, axis), owner.take(index + 1, axis))
    labels = np.where(values < 0.0, owner, np.uint8(NO_COMPONENT))
    return LabelGrid(labels=labels, origin=first * float(spacing), spacing=float(spacing))


def _interpolate(
    values: Float32[np.ndarray, "nx ny nz"],
    axis: int,
    index: Int[np.ndarray, " nodes"],
    fraction: Float[np.ndarray, " nodes"],
) -> Float32[np.ndarray, "mx my mz"]:
    """Linear interpolation along one axis."""
    weight = fraction.reshape([-1 if a == axis else 1 for a in range(3)])
    low, high = values.take(index, axis), values.take(index + 1, axis)
    return low + weight * (high - low)
