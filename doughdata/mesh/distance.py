"""Signed distance of a particle cloud by morphological closing, on a lattice.

All lengths here are in cells of the lattice. The closing is the set that no empty ball of radius R
can reach: inflate every particle by R, then deflate by R. Distances to particles and to samples of
the inflated surface are exact within reach of them.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32

from doughdata.mesh.compiled import spread_distance, spread_nearest

__all__ = ["closing_field", "level_for_volume"]

RIM = 1.0  # samples are at the nodes this near to the inflated surface: one or two a cell


def closing_field(
    points: Float[np.ndarray, "points 3"],
    shape: tuple[int, int, int],
    *,
    radius: float,
    level: float,
    band: float = 2.0,
) -> Float32[np.ndarray, "nx ny nz"]:
    """Distance to the closing of `points`, negative inside, on the nodes of a lattice.

    Exact up to the sampling of the inflated surface (`RIM`) where the result is
    within `band` of `level`; further away it stays beyond.

    Args:
        points: [cells], node (i, j, k) is at (i, j, k); at least `radius + 2` from the border.
        shape: nodes along each axis.
        radius: of the closing [cells].
        level: value that the caller will contour [cells].
        band: half-width of the exact band around `level` [cells].
    """
    inflated, seeds, outer = _inflate(points, shape, radius)
    depth = spread_distance(seeds, shape, radius - level + band)
    return np.where(inflated, np.float32(radius) - depth, outer)


def _inflate(
    points: Float[np.ndarray, "points 3"], shape: tuple[int, int, int], radius: float
) -> tuple[
    Bool[np.ndarray, "nx ny nz"], Float[np.ndarray, "seeds 3"], Float32[np.ndarray, "nx ny nz"]
]:
    """Union of balls: its nodes, samples of its surface, and distance outside of it."""
    distance, nearest = spread_nearest(points, shape, radius + RIM)
    inflated = distance < radius
    rim = ~inflated & (nearest >= 0)
    # the point of the surface that lies between an outer node and its nearest particle
    centre = points[nearest[rim]]
    away = (radius / distance[rim])[:, None]
    seeds = centre + (np.argwhere(rim) - centre) * away
    return inflated, seeds, distance.astype(np.float32)


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
