"""The Azure Kinect chain against its formulas."""

import math

import numpy as np
import pytest

from doughdata.geometry import pixel_rays
from doughdata.render.sensors.azure import Azure, AzureConfig
from doughdata.stages import DepthImage, Sensor
from doughschemas import SEGMENT_TABLE, Camera, Intrinsics


def camera(focal: float = 504.0) -> Camera:
    """A lens at the origin that looks along z, 640 x 480."""
    lens = Intrinsics(width=640, height=480, fx=focal, fy=focal, cx=319.5, cy=239.5)
    return Camera(intrinsics=lens, position=(0, 0, 0), quaternion=(0, 0, 0, 1))


def observe(
    depth: np.ndarray, view: Camera | None = None, seed: int = 0, **constants: float
) -> np.ndarray:
    """One observation with changed constants, in float64."""
    image = DepthImage(
        depth=depth.astype(np.float32), segments=np.full(depth.shape, SEGMENT_TABLE, np.uint8)
    )
    sensor = Azure(AzureConfig(**constants))
    return sensor.observe(image, view or camera(), rng=np.random.default_rng(seed)).astype(float)


def turned(degrees: float, view: Camera) -> np.ndarray:
    """Depth [m] of a plane through (0, 0, 0.6) turned about y."""
    slope = math.tan(math.radians(degrees))
    return 0.6 / (1 + slope * pixel_rays(view.intrinsics)[..., 0])


@pytest.mark.parametrize("depth", [0.4, 0.5, 0.6, 0.8, 1.0])
def test_noise_follows_the_formula(depth: float) -> None:
    """On a wall sigma is 0.5 mm, growing by 1 mm/m beyond 0.5 m, within 3 %, without bias."""
    error = observe(np.full((480, 640), depth)) - depth
    sigma = 0.5e-3 + max(depth - 0.5, 0) * 1e-3
    assert abs(error.std() / sigma - 1) < 0.03
    assert abs(error.mean()) < 0.02 * sigma


def test_shifts_turn_slope_into_noise() -> None:
    """On a ramp, shifts of 0.25 px along each axis add their slopes' share to the variance."""
    ramp = 0.45 + 2e-4 * np.add.outer(2 * np.arange(480.0), np.arange(640.0))
    error = (observe(ramp, sigma=0.0, sigma_slope=0.0) - ramp)[5:-5, 5:-5]
    assert abs(error.std() / (0.25 * 2e-4 * math.sqrt(5)) - 1) < 0.03
    assert abs(error.mean()) < 1e-6


def test_steps_leave_no_mixed_depth() -> None:
    """Beside a step of 60 mm pixels are invalid; no valid one lies between the two sides."""
    step = np.where(np.arange(640) < 320, 0.5, 0.56) * np.ones((480, 1))
    noisy = observe(step)
    assert (noisy[:, 319:321] == 0).mean() > 0.98
    assert (noisy[:, :316] > 0).all()
    assert (noisy[:, 324:] > 0).all()
    valid = noisy[noisy > 0]
    assert np.minimum(np.abs(valid - 0.5), np.abs(valid - 0.56)).max() < 0.021


@pytest.mark.parametrize(("degrees", "seen"), [(70.0, True), (81.0, True), (85.0, False)])
def test_what_returns_too_little_light_is_invalid(degrees: float, seen: bool) -> None:
    """A plane is dark where 0.5 cos(angle) < 15 / 255, which is beyond 83.2 degrees."""
    view = camera(focal=20_000.0)
    noisy = observe(turned(degrees, view), view, discontinuity=1.0)
    assert ((noisy > 0) == seen).all()


def test_a_brighter_surface_is_seen_at_a_steeper_angle() -> None:
    """With full reflectance the limit moves to 86.6 degrees."""
    view = camera(focal=60_000.0)
    assert (observe(turned(85.0, view), view, discontinuity=1.0, reflectance=1.0) > 0).all()
    assert (observe(turned(87.5, view), view, discontinuity=1.0, reflectance=1.0) == 0).all()


def test_unseen_pixels_stay_invalid() -> None:
    """Where the ideal camera hits nothing there is no depth, nor mixed depth at the border."""
    depth = np.full((480, 640), 0.5)
    depth[200:300, 200:400] = 0.0
    noisy = observe(depth)
    assert (noisy[depth == 0] == 0).all()
    assert (noisy[noisy > 0] > 0.49).all()


def test_noise_depends_on_the_generator_alone() -> None:
    """The same generator gives the same bytes, another one others; numpy's global one is unused."""
    depth = np.full((480, 640), 0.6)
    before = np.random.get_state()[1].copy()
    first, second, other = (observe(depth, seed=seed) for seed in (1, 1, 2))
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != other.tobytes()
    assert np.array_equal(np.random.get_state()[1], before)


def test_sensor_keeps_the_contract() -> None:
    """It needs no arguments and returns float32 of the image's shape."""
    sensor = Azure()
    ideal = DepthImage(
        depth=np.full((480, 640), 0.6, np.float32),
        segments=np.full((480, 640), SEGMENT_TABLE, np.uint8),
    )
    noisy = sensor.observe(ideal, camera(), rng=np.random.default_rng(0))
    assert isinstance(sensor, Sensor)
    assert (noisy.dtype, noisy.shape) == (np.float32, (480, 640))
