"""Intel RealSense D400: active stereo with noise in disparity that is correlated in space."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32

from doughdata.registry import require_package
from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["RealSense", "RealSenseConfig", "correlated_field", "hidden_from_second_camera"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RealSenseConfig:
    """Constants of the model.

    The noise was measured on real D4xx recordings of table tops, 640 x 480, f = 616 px: standard
    deviation 0.34 / 0.46 / 0.59 / 0.73 / 1.01 mm at about 0.40 / 0.50 / 0.60 / 0.70 / 0.82 m,
    autocorrelation 0.94 / 0.87 / 0.71 / 0.42 at lags 1 / 2 / 4 / 8 px. The pure z^2 law of stereo
    does not fit the near distances; a term that does not depend on depth, added in variance, does.
    exp(-(lag / 8.94 px)^1.315) fits the autocorrelation within 0.006. The model is isotropic;
    one recording at hand shows a shorter range along columns (0.73 / 0.59 / 0.36 / 0.0).

    Pixel constants hold for a picture 640 px wide and grow with the width: a wider picture is
    taken to be the same sensor, resampled. The D400 matches at the resolution that it streams, and
    no recording at another one was at hand, so this is a choice, not a measurement.
    """

    baseline: float = 0.050  # [m], D435 (D415: 0.055)
    sigma_constant: float = 0.26e-3  # [m], standard deviation that does not depend on depth
    sigma_quadratic: float = 1.40e-3  # [1/m], times z^2
    correlation_length: float = 8.94  # [px at 640]
    correlation_power: float = 1.315
    subpixel: float = 1 / 32  # [px at 640], disparity step of the D4 chip
    max_disparity: float = 126.0  # [px at 640], search range: nearer points have no match


class RealSense:
    """Left camera = depth camera; the second stands `baseline` to its right.

    A pixel is invalid where its partner lies outside the second picture (a band at the left), is
    hidden from the second camera (a shadow at the left of near things), or too near. The others
    get a disparity error with the measured law, then the disparity is rounded.
    """

    def __init__(self, config: RealSenseConfig | None = None) -> None:
        self.config = config or RealSenseConfig()

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid."""
        c, scale = self.config, camera.intrinsics.width / 640
        focal_baseline = camera.intrinsics.fx * c.baseline
        seen = image.depth > 0
        disparity = np.zeros_like(image.depth)
        np.divide(focal_baseline, image.depth, out=disparity, where=seen)
        valid = seen & (disparity <= c.max_disparity * scale)
        valid &= ~hidden_from_second_camera(disparity)
        field = correlated_field(
            image.depth.shape, rng, length=c.correlation_length * scale, power=c.correlation_power
        )
        noisy = disparity + self._disparity_sigma(image.depth, focal_baseline, scale) * field
        step = np.float32(c.subpixel * scale)
        noisy = np.rint(noisy / step) * step
        valid &= noisy > 0
        depth = np.zeros_like(image.depth)
        return np.divide(focal_baseline, noisy, out=depth, where=valid)

    def _disparity_sigma(
        self, depth: Float32[np.ndarray, "rows columns"], focal_baseline: float, scale: float
    ) -> Float32[np.ndarray, "rows columns"]:
        """Standard deviation [px] that, with the rounding error, gives the measured depth noise.

        Disparity d = f B / z, so an error of s [m] in depth is s f B / z^2 pixels.
        """
        c = self.config
        square = np.where(depth > 0, depth, np.float32(1)) ** 2
        to_pixels = focal_baseline / square
        variance = np.float32(c.sigma_constant**2) + (np.float32(c.sigma_quadratic) * square) ** 2
        rounding = np.float32((c.subpixel * scale) ** 2 / 12)
        return np.sqrt(np.maximum(variance * to_pixels**2 - rounding, 0))


def hidden_from_second_camera(
    disparity: Float32[np.ndarray, "rows columns"],
) -> Bool[np.ndarray, "rows columns"]:
    """Pixels that a second camera to the right does not see, from disparities [px], 0 = no hit.

    A point at column u is at u - d in the second picture. It is hidden where something nearer
    lands in the same column, or where that column lies outside the picture. What the first camera
    does not see cannot hide anything; for a short baseline that is next to nothing.
    """
    rows, columns = disparity.shape
    target = np.arange(columns, dtype=np.float32) - disparity
    column = np.floor(target).astype(np.int32)
    outside = target < 0
    # One spare column at the right takes what lands outside, so that nothing wraps round.
    column = np.where(outside | (disparity <= 0), columns, column)
    flat = column + np.arange(rows, dtype=np.int32)[:, None] * (columns + 2)
    # In one column of the second picture the nearest comes from the rightmost pixel of the first
    # (u = column + d), and an assignment to a repeated index keeps the last value.
    nearest, after = np.zeros((2, rows * (columns + 2)), np.float32)
    nearest[flat.ravel()] = disparity.ravel()
    # A surface turned away is stretched in the second picture; the column after closes its gaps.
    after[flat.ravel() + 1] = disparity.ravel()
    nearest = np.maximum(nearest, after)
    return outside | (nearest[flat] > disparity + 1.0)


def correlated_field(
    shape: tuple[int, int], rng: np.random.Generator, *, length: float, power: float
) -> Float32[np.ndarray, "rows columns"]:
    """Gaussian field of unit variance with the autocorrelation exp(-(lag / length)^power).

    Drawn by circulant embedding (Dietrich and Newsam, 1997): white noise, filtered on a torus that
    is wide enough not to be felt. `length` in pixels, 0 < `power` <= 2.
    """
    fft = require_package("scipy.fft", extra="render")
    size, filter_gain = _filter(shape, length, power)
    white = rng.standard_normal(size, dtype=np.float32)
    field = fft.irfft2(fft.rfft2(white) * filter_gain, s=size)
    return field[: shape[0], : shape[1]]


@lru_cache(maxsize=8)
def _filter(
    shape: tuple[int, int], length: float, power: float
) -> tuple[tuple[int, int], Float32[np.ndarray, "rows half_columns"]]:
    """Size of the torus and the gain of each frequency."""
    fft = require_package("scipy.fft", extra="render")
    margin = math.ceil(4 * length)  # the correlation left there is below 0.3 %
    size = tuple(fft.next_fast_len(extent + margin, real=True) for extent in shape)
    lags = [np.minimum(np.arange(extent), extent - np.arange(extent)) for extent in size]
    distance = np.hypot(lags[0][:, None], lags[1][None, :])
    spectrum = fft.rfft2(np.exp(-((distance / length) ** power))).real
    gain = np.sqrt(np.maximum(spectrum, 0)).astype(np.float32)
    gain.setflags(write=False)  # it is shared
    return (size[0], size[1]), gain
