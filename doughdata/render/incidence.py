"""How surfaces in a depth image are turned: the slope of inverse depth, the angle of incidence."""

import numpy as np
from jaxtyping import Float32

from doughdata.geometry import pixel_rays
from doughschemas import Camera

__all__ = ["incidence_angle", "inverse_depth_slope"]


def inverse_depth_slope(
    depth: Float32[np.ndarray, "rows columns"],
) -> tuple[
    Float32[np.ndarray, "rows columns"],
    Float32[np.ndarray, "rows columns"],
    Float32[np.ndarray, "rows columns"],
]:
    """Inverse depth [1/m] and its slope along columns and rows [1/m a pixel].

    Inverse depth, not depth, is linear over the picture of a plane. Of the differences to the two
    neighbours the smaller one counts, so that a step in depth does not look like a slope. Invalid
    pixels (depth 0) have inverse depth 0 and no slope, and give none to their neighbours.
    """
    inverse = np.zeros_like(depth)
    np.divide(np.float32(1), depth, out=inverse, where=depth > 0)
    return inverse, _slope(inverse), _slope(inverse.T).T


def incidence_angle(
    depth: Float32[np.ndarray, "rows columns"], camera: Camera
) -> Float32[np.ndarray, "rows columns"]:
    """Angle [rad], 0..pi/2, between the surface normal and the ray of each pixel.

    A plane with normal n at distance d has inverse depth n . ray / d, where rays have z = 1. So
    inverse depth and its slopes give n / d, without any points. Invalid pixels get pi/2.
    """
    lens = camera.intrinsics
    rays = pixel_rays(lens)
    inverse, along_u, along_v = inverse_depth_slope(depth)
    normal_x, normal_y = lens.fx * along_u, lens.fy * along_v
    normal_z = inverse - rays[..., 0] * normal_x - rays[..., 1] * normal_y
    lengths = np.sqrt((normal_x**2 + normal_y**2 + normal_z**2) * (rays**2).sum(axis=-1))
    cosine = np.divide(inverse, lengths, out=np.zeros(depth.shape), where=lengths > 0)
    return np.arccos(np.clip(cosine, 0.0, 1.0)).astype(np.float32)


def _slope(
    inverse: Float32[np.ndarray, "rows columns"],
) -> Float32[np.ndarray, "rows columns"]:
    """Smaller of the differences to the left and right neighbour; 0 where there is neither."""
    difference = np.diff(inverse, axis=1)
    difference[(inverse[:, 1:] == 0) | (inverse[:, :-1] == 0)] = np.inf
    edge = np.full((len(inverse), 1), np.inf, np.float32)
    left, right = np.hstack([edge, difference]), np.hstack([difference, edge])
    smaller = np.where(np.abs(left) <= np.abs(right), left, right)
    return np.where(np.isfinite(smaller), smaller, np.float32(0))
