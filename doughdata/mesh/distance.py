"""Signed distance of a particle cloud by morphological closing, on a lattice.

All lengths here are in cells of the lattice. The closing is the set that no empty ball of radius R
can reach: inflate every particle by R, then deflate by R. Two narrow bands of exact nearest
neighbours carry it; distances between nodes, no further than needed, find the bands.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from doughdata.registry import require_package

__all__ = ["closing_field", "level_for_volume", "nearest_node_distance"]

ROUNDING = 0.87  # a particle lies within sqrt(3)/2 of the node it is rounded to


def closing_field(
    points: Float[np.ndarray, "points 3"],
    shape: tuple[int, int, int],
    *,
    radius: float,
    level: float,
    band: float = 2.0,
) -> Float32[np.ndarray, "nx ny nz"]:
    """Distance to the closing of `points`, negative inside, on the nodes of a lattice.

    Exact up to the sampling of the inflated surface (one sample a cell) where the result is
    within `band` of `level`, a rough estimate of the right sign elsewhere.

    Args:
        points: [cells], node (i, j, k) is at (i, j, k); at least `radius + 2` from the border.
        shape: nodes along each axis.
        radius: of the closing [cells].
        level: value that the caller will contour [cells].
        band: half-width of the exact band around `level` [cells].
    """
    spatial = require_package("scipy.spatial", extra="sim")
    inflated, seeds, outer = _inflate(points, shape, radius)
    reach = radius - level + band + 1.1  # beyond `near`
    depth = nearest_node_distance(_rim(inflated), shape, reach=reach) - 0.5
    field = np.where(inflated, radius - depth, outer)
    # depth is 0.5 + rounding off by at most one cell
    near = inflated & (np.abs(field - level) < band + 0.5)
    nodes = np.argwhere(near)
    distance, _ = spatial.cKDTree(seeds, balanced_tree=False, compact_nodes=False).query(nodes)
    field[near] = radius - distance
    return field


def _inflate(
    points: Float[np.ndarray, "points 3"], shape: tuple[int, int, int], radius: float
) -> tuple[
    Bool[np.ndarray, "nx ny nz"], Float[np.ndarray, "seeds 3"], Float32[np.ndarray, "nx ny nz"]
]:
    """Union of balls: its nodes, samples of its surface, and radius + distance outside of it."""
    spatial = require_package("scipy.spatial", extra="sim")
    occupied = np.rint(points).astype(np.intp)
    rough = nearest_node_distance(occupied, shape, reach=radius + ROUNDING + 0.2)
    shell = np.abs(rough - (radius + 0.1)) < ROUNDING + 0.1
    nodes = np.argwhere(shell)
    tree = spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)
    distance, nearest = tree.query(nodes)
    inflated = rough < radius
    inflated[shell] = distance < radius
    outer = np.maximum(rough, np.float32(radius))
    outer[shell] = distance
    # the point of the surface that lies between an outer node and its nearest particle
    outside = distance >= radius
    centre = points[nearest[outside]]
    seeds = centre + (nodes[outside] - centre) * (radius / distance[outside])[:, None]
    return inflated, seeds, outer


def _rim(mask: Bool[np.ndarray, "nx ny nz"]) -> Int[np.ndarray, "nodes 3"]:
    """The nodes outside a mask that share a grid edge with it."""
    beside = np.zeros_like(mask)
    for axis in range(3):
        rows, marks = np.moveaxis(mask, axis, 0), np.moveaxis(beside, axis, 0)
        marks[1:] |= rows[:-1]
        marks[:-1] |= rows[1:]
    return np.argwhere(beside & ~mask)


def nearest_node_distance(
    nodes: Int[np.ndarray, "nodes 3"], shape: tuple[int, int, int], *, reach: float
) -> Float32[np.ndarray, "nx ny nz"]:
    """Distance [cells] of every node to the nearest of some, exact up to `reach`, else `reach`.

    Each offset writes its length, the longest first, so that the shortest stays: a quarter of the
    time of a Euclidean distance transform of the whole lattice.
    """
    pad = int(reach)
    steps = np.arange(-pad, pad + 1)
    offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    length = np.sqrt((offsets**2).sum(axis=1))
    order = np.argsort(-length, kind="stable")
    order = order[length[order] < reach]
    wide = np.full([n + 2 * pad for n in shape], reach, np.float32)
    strides = np.array([wide.shape[1] * wide.shape[2], wide.shape[2], 1])
    flat, index = wide.reshape(-1), np.unique((nodes + pad) @ strides)
    for step, value in zip((offsets @ strides)[order].tolist(), length[order], strict=True):
        flat[index + step] = value
    inner = tuple(slice(pad, pad + n) for n in shape)
    return np.ascontiguousarray(wide[inner])


def level_for_volume(
    field: Float32[np.ndarray, "nx ny nz"], volume: float, *, low: float, high: float
) -> float:
    """Level whose sublevel set has a volume [cells^3], within [low, high]; bisection.

    The volume of {field < level} is the sum of clip(1/2 + level - field, 0, 1) over the nodes:
    exact for planes along the axes, second order in the curvature otherwise.
    """
    values = field[(field > low - 0.5) & (field < high + 0.5)]
    base = int(np.count_nonzero(field <= low - 0.5))
    for _ in range(20):
        level = 0.5 * (low + high)
        if base + float(np.clip(level + 0.5 - values, 0.0, 1.0).sum()) < volume:
            low = level
        else:
            high = level
    return 0.5 * (low + high)
