"""Microsoft Kinect v1 by the noise that Nguyen, Izadi and Lovell measured (3DIMPVT 2012)."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int

from doughdata.render.incidence import incidence_angle, inverse_depth_slope
from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["Kinect", "KinectConfig"]

FIT_FROM = 0.4  # [m], where the quadratic term of the fit begins


@dataclass(frozen=True, slots=True, kw_only=True)
class KinectConfig:
    """Constants of "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking".

    Axial, with z in metres and the angle t between the normal and the viewing direction in rad:
    sigma_z = axial + axial_quadratic (z - 0.4)^2 + axial_angle / sqrt(z) (t / (pi/2 - t))^2.
    Lateral, across an outline: sigma_L = lateral + lateral_angle t / (pi/2 - t). Both were fitted
    to planes 0.4-3 m away, turned by up to 60 degrees. `angle_max` is a choice: the fit grows
    without limit there, and a real sensor reports nothing. Pixel constants hold for a picture
    640 px wide and grow with the width.
    """

    axial: float = 1.2e-3  # [m]
    axial_quadratic: float = 1.9e-3  # [1/m]
    axial_angle: float = 1e-4  # [m^1.5]
    lateral: float = 0.8  # [px at 640]
    lateral_angle: float = 0.035  # [px at 640]
    angle_max: float = math.radians(82.0)  # steeper surfaces are invalid
    range_min: float = 0.4  # [m], of the sensor's near mode; nearer surfaces are invalid


class Kinect:
    """Each pixel sees the surface a random shift beside it, then gets an axial error.

    The lateral noise was measured as the raggedness of outlines, the axial one as the deviation
    from planes, so a shift must not add to the deviation on a plane: what a shifted pixel sees is
    its own tangent plane, plus the difference of the other surface from that plane. The noise is
    white. The projector's shadow and the steps in disparity are left out; `stereo` has both.
    """

    def __init__(self, config: KinectConfig | None = None) -> None:
        self.config = config or KinectConfig()

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid."""
        c = self.config
        angle = np.minimum(incidence_angle(image.depth, camera), np.float32(c.angle_max))
        steepness = angle / (np.float32(math.pi / 2) - angle)
        sigma_px = (c.lateral + c.lateral_angle * steepness) * (camera.intrinsics.width / 640)
        shift = rng.standard_normal((2, *angle.shape), dtype=np.float32) * sigma_px
        depth = _shifted(image.depth, np.rint(shift).astype(np.int32))
        near = np.where(depth > 0, depth, np.float32(1))
        sigma = c.axial + c.axial_quadratic * (near - np.float32(FIT_FROM)) ** 2
        sigma = sigma + c.axial_angle / np.sqrt(near) * steepness**2
        noisy = depth + sigma * rng.standard_normal(depth.shape, dtype=np.float32)
        valid = (image.depth > 0) & (angle < c.angle_max) & (depth >= c.range_min) & (noisy > 0)
        return np.where(valid, noisy, 0).astype(np.float32)


def _shifted(
    depth: Float32[np.ndarray, "rows columns"], shift: Int[np.ndarray, "2 rows columns"]
) -> Float32[np.ndarray, "rows columns"]:
    """Depth [m] seen a whole number of pixels (row, column) away; 0 where nothing is there.

    Exact on planes: there the other pixel's inverse depth is what the slope predicts.
    """
    inverse, along_u, along_v = inverse_depth_slope(depth)
    row, column = np.indices(depth.shape, dtype=np.int32)
    other_row = np.clip(row + shift[0], 0, depth.shape[0] - 1)
    other_column = np.clip(column + shift[1], 0, depth.shape[1] - 1)
    other = inverse[other_row, other_column]
    predicted = (other_column - column) * along_u + (other_row - row) * along_v
    seen = np.where(other > 0, other - predicted, np.float32(0))
    result = np.zeros_like(depth)
    return np.divide(np.float32(1), seen, out=result, where=seen > 0)
