"""The paper's sensor chain, whose constants are those of BlenderProc's Kinect Azure model."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from doughdata.registry import require_package
from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["BlenderProc", "BlenderProcConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BlenderProcConfig:
    """Constants of the chain.

    Shift and Gaussian offset: BlenderProc 2.8, `add_kinect_azure_noise` (after Tolgyessy et al.,
    2021). Its threshold for discontinuities, 0.8 m, removes nothing on a table top; 20 mm removes
    1.5 % there. Low resolution with bilinear upscaling is the paper's addition. The rule that dark
    pixels are invalid is left out: there is no colour here.
    """

    low_resolution: int = 2  # every n-th pixel is rendered, the others are interpolated
    shift_sigma: float = 0.25  # [px], of the picture after upscaling
    discontinuity: float = 0.020  # [m], largest depth range of a valid 3 x 3 window
    sigma: float = 0.5e-3  # [m], standard deviation up to `sigma_from`
    sigma_from: float = 0.5  # [m]
    sigma_slope: float = 1e-3  # [m/m], growth beyond


class BlenderProc:
    """Low resolution, bilinear upscaling, pixel shifts, discontinuities removed, Gaussian offset.

    The offset comes last: interpolation would average it away (to 0.63 of its standard deviation
    for a factor of two). So on a plane the noise follows the formula: sigma + slope (z - 0.5 m).
    """

    def __init__(self, config: BlenderProcConfig | None = None) -> None:
        self.config = config or BlenderProcConfig()

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid."""
        del camera  # all constants are in pixels and metres
        c, ndimage = self.config, require_package("scipy.ndimage", extra="render")
        rows, columns = (np.arange(extent, dtype=np.float32) for extent in image.depth.shape)
        depth = _upscaled(image.depth, c.low_resolution)
        shift = rng.standard_normal((2, *depth.shape), dtype=np.float32) * np.float32(c.shift_sigma)
        depth = _bilinear(depth, rows[:, None] + shift[0], columns + shift[1])
        spread = ndimage.maximum_filter(depth, 3) - ndimage.minimum_filter(depth, 3)
        sigma = c.sigma + c.sigma_slope * np.maximum(depth - c.sigma_from, 0)
        noisy = depth + sigma * rng.standard_normal(depth.shape, dtype=np.float32)
        # Where the ideal camera sees nothing, no interpolation may invent depth.
        valid = (depth > 0) & (image.depth > 0) & (spread <= c.discontinuity)
        return np.where(valid, noisy, 0).astype(np.float32)


def _upscaled(
    depth: Float32[np.ndarray, "rows columns"], factor: int
) -> Float32[np.ndarray, "rows columns"]:
    """Keep every `factor`-th pixel and the last of each axis; interpolate the others linearly.

    The kept pixels stay where they are, so a plane is not displaced.
    """
    if factor <= 1:
        return depth
    knots = [np.unique(np.append(np.arange(0, n, factor), n - 1)) for n in depth.shape]
    low = depth[np.ix_(*knots)]
    rows, columns = (
        np.interp(np.arange(n), kept, np.arange(len(kept))).astype(np.float32)
        for n, kept in zip(depth.shape, knots, strict=True)
    )
    return _bilinear(low, rows[:, None], columns[None, :])


def _bilinear(
    depth: Float32[np.ndarray, "rows columns"],
    row: Float[np.ndarray, "#out_rows #out_columns"],
    column: Float[np.ndarray, "#out_rows #out_columns"],
) -> Float32[np.ndarray, "out_rows out_columns"]:
    """Depth at broken pixel positions, clamped to the picture; 0 where a neighbour is invalid."""
    rows, columns = depth.shape
    row, column = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    top, left = row.astype(np.int32), column.astype(np.int32)
    down, right = np.minimum(top + 1, rows - 1), np.minimum(left + 1, columns - 1)
    v, u = row - top, column - left
    a, b, c, d = depth[top, left], depth[top, right], depth[down, left], depth[down, right]
    mixed = (a + (b - a) * u) * (1 - v) + (c + (d - c) * u) * v
    return np.where((a > 0) & (b > 0) & (c > 0) & (d > 0), mixed, 0).astype(np.float32)
