"""Active stereo: a projected dot pattern, two infrared pictures, and a real block matcher.

The pictures are synthesised from the ideal depth image. All work is done on a picture that is
widened to the left by the search range, so that no pattern or partner is lost at the border.
Disparities d = f B / z in pixels, between the depth camera (left) and a camera `baseline` to its
right; the projector stands between them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from doughdata.registry import require_package
from doughdata.render.incidence import incidence_angle
from doughdata.render.sensors.realsense import hidden_from_second_camera
from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["Stereo", "StereoConfig", "second_view"]

PATTERN_HALF = (0.9, 0.7)  # tangents of the projector's half angles, wider than the camera sees
PATTERN_STEP = 5e-4  # [tangent], side of a texel of the pattern
STEPS = 16  # OpenCV reports disparity in 16ths of a pixel
COVERED = 4  # columns of the second picture that the gap between two pixels can cover


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoConfig:
    """The rig and the matcher. Pixel constants hold for a picture 640 px wide.

    Baseline and search range are those of `realsense`. Dots, light and noise are choices that give
    the matcher what an infrared picture gives it: dots about a pixel wide, one in every 14 pixels
    of the default camera, dimmer with distance and on surfaces turned away. The penalties are a
    quarter of those that OpenCV's manual recommends (8 and 32): these push a tilted table 0.1 px
    away from the camera, a quarter of them 0.005 px.
    """

    baseline: float = 0.050  # [m], D435
    projector: float = 0.5  # share of the baseline at which the projector stands
    dots: int = 40_000  # over the projector's whole field
    dot_sigma: float = 2e-3  # [tangent], radius of a dot
    pattern_seed: int = 0  # the pattern belongs to the device and never changes
    ambient: float = 0.08  # share of full brightness without dots
    gain: float = 0.8  # of a dot's centre, facing the camera at the median depth
    noise: float = 0.02  # standard deviation of a pixel's brightness, share of full
    max_disparity: float = 126.0  # [px at 640], search range: nearer points have no match
    window: int = 7  # [px], side of the matcher's window, odd
    penalty_small: int = 2  # for a disparity one beside its neighbour's, times window^2
    penalty_large: int = 8  # for any other one
    clip: int = 31  # of the picture's slope, before costs are computed
    uniqueness: int = 10  # [%], by which the best match must beat the second
    speckle: int = 60  # [px], smaller islands are removed


class Stereo:
    """OpenCV's semi-global matcher on two synthetic infrared pictures.

    It brings what formulas lack: depth in terraces of 1/16 px, edges that grow by half a window,
    shadows at the left of near things, holes where no dot falls. Left out, because one depth image
    does not know it: surfaces that only the second camera sees (it sees the far side of the gap
    continued), pixels mixed at outlines, texture, gloss, lens blur and distortion.
    """

    def __init__(self, config: StereoConfig | None = None) -> None:
        self.config = config or StereoConfig()

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid.

        Raises:
            MissingPackageError: OpenCV is not installed.
        """
        c = self.config
        focal_baseline = camera.intrinsics.fx * c.baseline
        wanted = c.max_disparity * camera.intrinsics.width / 640
        search = int(np.ceil((wanted + 1) / 16)) * 16  # a multiple of 16 is asked for
        left, right = self._pictures(image, camera, search, rng)
        disparity = _match(left, right, search=search, config=c)[:, search:]
        columns = np.arange(disparity.shape[1])
        valid = (image.depth > 0) & (disparity > 0) & (disparity <= wanted)
        valid &= columns >= disparity  # its partner lies inside the second picture
        depth = np.zeros_like(image.depth)
        return np.divide(np.float32(focal_baseline), disparity, out=depth, where=valid)

    def _pictures(
        self, image: DepthImage, camera: Camera, margin: int, rng: np.random.Generator
    ) -> tuple[UInt8[np.ndarray, "rows wide"], UInt8[np.ndarray, "rows wide"]]:
        """What both cameras see, widened to the left by `margin` columns."""
        c, lens = self.config, camera.intrinsics
        pad = ((0, 0), (margin, 0))
        depth = np.pad(image.depth, pad, mode="edge")
        seen = np.where(depth > 0, depth, np.float32(np.inf))
        disparity = (lens.fx * c.baseline / seen).astype(np.float32)
        shadow = _shadow(disparity * np.float32(c.projector))
        facing = np.pad(np.cos(incidence_angle(image.depth, camera)), pad, mode="edge")
        middle = np.median(depth[depth > 0]) if (depth > 0).any() else 1.0
        light = np.float32(c.gain) * facing * np.minimum((middle / seen) ** 2, 1.5)
        light = np.where(shadow, 0, light).astype(np.float32)
        other, column = second_view(disparity)
        light_there = np.take_along_axis(light, column, axis=1)
        return (
            self._expose(light, disparity, camera, -margin, 0.0, rng),
            self._expose(light_there, other, camera, -margin, 1.0, rng),
        )

    def _expose(
        self,
        light: Float32[np.ndarray, "rows wide"],
        disparity: Float32[np.ndarray, "rows wide"],
        camera: Camera,
        first_column: int,
        place: float,
        rng: np.random.Generator,
    ) -> UInt8[np.ndarray, "rows wide"]:
        """Brightness that a camera at `place` (0 left, 1 right) of the baseline reports.

        A point that this camera sees at column u is at the tangent (u - cx + (place - projector) d)
        / fx of the projector: all three look along parallel axes.
        """
        c, lens = self.config, camera.intrinsics
        ndimage = require_package("scipy.ndimage", extra="render")
        rows, columns = disparity.shape
        u = np.arange(first_column, first_column + columns, dtype=np.float32)
        x = (u - np.float32(lens.cx) + np.float32(place - c.projector) * disparity) / lens.fx
        y = (np.arange(rows, dtype=np.float32) - lens.cy) / lens.fy
        texel_x = (x + PATTERN_HALF[0]) / PATTERN_STEP
        texel_y = np.broadcast_to(((y + PATTERN_HALF[1]) / PATTERN_STEP)[:, None], x.shape)
        pattern = _dot_pattern(c.dots, c.dot_sigma, c.pattern_seed)
        dots = ndimage.map_coordinates(pattern, [texel_y, texel_x], order=1, mode="grid-wrap")
        brightness = np.where(disparity > 0, np.float32(c.ambient) + light * dots, 0)
        brightness += np.float32(c.noise) * rng.standard_normal(x.shape, dtype=np.float32)
        return np.rint(np.clip(brightness, 0, 1) * 255).astype(np.uint8)


def second_view(
    disparity: Float32[np.ndarray, "rows columns"],
) -> tuple[Float32[np.ndarray, "rows columns"], np.ndarray]:
    """Disparity [px] of what a second camera to the right sees, and where the first sees it.

    Between neighbouring pixels of one surface disparity is interpolated. Where the second camera
    looks behind an outline, the farther side goes on to it. 0 = nothing there. The columns say
    which pixel of the first picture is nearest, for looking up what belongs to the surface.
    """
    rows, columns = disparity.shape
    start = np.arange(columns, dtype=np.float32) - disparity
    gap = np.diff(start, axis=1)  # 1 on a wall; an outline makes it large or negative
    far = np.minimum(disparity[:, :-1], disparity[:, 1:])
    smooth = np.abs(np.diff(disparity, axis=1)) <= 1.0
    first = np.ceil(start[:, :-1])
    offset = (np.arange(rows) * (columns + 1))[:, None]
    seen = np.zeros(rows * (columns + 1), np.float32)
    for step in range(COVERED):
        column = first + step
        part = (column - start[:, :-1]) / np.where(gap > 0, gap, np.float32(1))
        between = disparity[:, :-1] + part * np.diff(disparity, axis=1)
        value = np.where(smooth, between, far)
        inside = (part < 1) & (gap > 0) & (column >= 0) & (disparity[:, :-1] > 0) & (value > 0)
        # In one column the nearest comes from the rightmost pixel, and the last value is kept.
        layer = np.zeros_like(seen)
        flat = np.where(inside, column, columns).astype(np.int64) + offset
        layer[flat.ravel()] = value.ravel()
        seen = np.maximum(seen, layer)
    seen = _filled(seen.reshape(rows, columns + 1)[:, :columns])
    source = np.rint(np.arange(columns, dtype=np.float32) + seen).astype(np.int64)
    return seen, np.clip(source, 0, columns - 1)


def _filled(
    disparity: Float32[np.ndarray, "rows columns"],
) -> Float32[np.ndarray, "rows columns"]:
    """Give a pixel without a value that of the next one to its right: the farther side."""
    columns = disparity.shape[1]
    index = np.where(disparity > 0, np.arange(columns), columns - 1)
    following = np.minimum.accumulate(index[:, ::-1], axis=1)[:, ::-1]
    return np.take_along_axis(disparity, following, axis=1)


def _shadow(
    disparity: Float32[np.ndarray, "rows wide"],
) -> Bool[np.ndarray, "rows wide"]:
    """Pixels that the projector does not light, from disparities between it and the camera."""
    hidden = hidden_from_second_camera(disparity)
    # What lies left of the widened picture is in its margin, and lit like the rest.
    return hidden & (np.arange(disparity.shape[1], dtype=np.float32) >= disparity)


@lru_cache(maxsize=2)
def _dot_pattern(count: int, sigma: float, seed: int) -> Float32[np.ndarray, "texel_rows texels"]:
    """Blurred dots at random places, centre of a lone dot 1."""
    ndimage = require_package("scipy.ndimage", extra="render")
    width, height = (round(2 * half / PATTERN_STEP) for half in PATTERN_HALF)
    rng = np.random.default_rng(seed)
    pattern = np.zeros((height, width), np.float32)
    pattern[rng.integers(0, height, count), rng.integers(0, width, count)] = 1.0
    radius = sigma / PATTERN_STEP
    pattern = ndimage.gaussian_filter(pattern, radius, mode="wrap") * (2 * np.pi * radius**2)
    pattern = np.minimum(pattern, 1.0).astype(np.float32)
    pattern.setflags(write=False)  # it is shared
    return pattern


def _match(
    left: UInt8[np.ndarray, "rows wide"],
    right: UInt8[np.ndarray, "rows wide"],
    *,
    search: int,
    config: StereoConfig,
) -> Float32[np.ndarray, "rows wide"]:
    """Disparity [px] by OpenCV's semi-global matcher, negative where it finds none."""
    cv2 = require_package("cv2", extra="render")
    area = config.window**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=search,
        blockSize=config.window,
        P1=config.penalty_small * area,
        P2=config.penalty_large * area,
        preFilterCap=config.clip,
        disp12MaxDiff=1,
        uniquenessRatio=config.uniqueness,
        speckleWindowSize=config.speckle,
        speckleRange=1,
    )
    return matcher.compute(left, right).astype(np.float32) / STEPS
