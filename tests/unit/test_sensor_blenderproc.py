"""The paper's sensor chain against its formulas."""

import numpy as np
import pytest

from doughdata.registry import load, names
from doughdata.render.cameras import default_camera
from doughdata.render.sensors.blenderproc import BlenderProc, BlenderProcConfig
from doughdata.render.sensors.none import NoNoise
from doughdata.stages import DepthImage, Sensor
from doughschemas import SEGMENT_TABLE

CAMERA = default_camera()
QUIET = {"sigma": 0.0, "sigma_slope": 0.0}


def image(depth: np.ndarray) -> DepthImage:
    """An image of the table."""
    return DepthImage(
        depth=depth.astype(np.float32), segments=np.full(depth.shape, SEGMENT_TABLE, np.uint8)
    )


def observe(depth: np.ndarray, **constants: float) -> np.ndarray:
    """One observation with changed constants, in float64."""
    sensor = BlenderProc(BlenderProcConfig(**constants))  # type: ignore[arg-type]
    return sensor.observe(image(depth), CAMERA, rng=np.random.default_rng(0)).astype(float)


@pytest.mark.parametrize("depth", [0.4, 0.5, 0.6, 0.8, 1.0])
def test_noise_follows_the_formula(depth: float) -> None:
    """On a wall sigma is 0.5 mm, growing by 1 mm/m beyond 0.5 m, within 3 %, without bias."""
    error = observe(np.full((360, 640), depth)) - depth
    sigma = 0.5e-3 + max(depth - 0.5, 0) * 1e-3
    assert abs(error.std() / sigma - 1) < 0.03
    assert abs(error.mean()) < 0.02 * sigma


def test_shifts_turn_slope_into_noise() -> None:
    """On a ramp, shifts of 0.25 px alone give a deviation of 0.25 px times the slope."""
    ramp = np.broadcast_to(0.5 + 1e-3 * np.arange(200.0), (150, 200))
    error = (observe(ramp, **QUIET) - ramp)[5:-5, 5:-5]
    assert abs(error.std() / 0.25e-3 - 1) < 0.03
    assert abs(error.mean()) < 0.01e-3


def test_low_resolution_smooths_steps_and_keeps_ramps() -> None:
    """Interpolation leaves a ramp as it is and puts the mean between the two sides of a step."""
    ramp = 0.5 + 1e-3 * np.add.outer(np.arange(151.0), np.arange(200.0))
    still = observe(ramp, **QUIET, shift_sigma=0.0, discontinuity=1.0, low_resolution=2)
    assert np.abs(still - ramp).max() < 1e-6
    step = np.where(np.arange(200) < 101, 0.50, 0.54) * np.ones((150, 1))
    smooth = observe(step, **QUIET, shift_sigma=0.0, discontinuity=1.0, low_resolution=2)
    assert np.allclose(smooth[:, 101], 0.52, atol=1e-6)
    assert np.allclose(smooth[:, [100, 102]], [0.50, 0.54], atol=1e-6)


def test_large_steps_are_removed_and_small_ones_stay() -> None:
    """Beside a step of 40 mm pixels are invalid, beside one of 10 mm and elsewhere none."""
    for height, removed in ((0.040, True), (0.010, False)):
        step = np.where(np.arange(200) < 100, 0.5, 0.5 + height) * np.ones((150, 1))
        noisy = observe(step)
        assert ((noisy[:, 99] == 0).mean() > 0.98) == removed
        assert ((noisy > 0).all()) != removed
        assert (noisy[:, :95] > 0).all()
        assert (noisy[:, 105:] > 0).all()


def test_unseen_pixels_stay_invalid() -> None:
    """Where the ideal camera hits nothing there is no depth, nor mixed depth at the border."""
    depth = np.full((60, 80), 0.5)
    depth[20:40, 30:50] = 0.0
    noisy = observe(depth)
    assert (noisy[20:40, 30:50] == 0).all()
    assert (noisy[noisy > 0] > 0.49).all()


def test_ideal_sensor_changes_nothing() -> None:
    """`none` returns the ideal depth bit for bit."""
    depth = np.random.default_rng(0).uniform(0.3, 1.0, (20, 30))
    ideal = image(depth)
    assert np.array_equal(
        NoNoise().observe(ideal, CAMERA, rng=np.random.default_rng(0)), ideal.depth
    )


@pytest.mark.parametrize("name", ["none", "realsense", "blenderproc", "kinect", "azure", "stereo"])
def test_sensors_are_found_by_name(name: str) -> None:
    """Each built-in loads from its entry point, needs no arguments and keeps the contract."""
    assert name in names("sensors")
    sensor = load("sensors", name)()
    assert isinstance(sensor, Sensor)
    ideal = image(np.full((CAMERA.intrinsics.height, CAMERA.intrinsics.width), 0.6))
    noisy = sensor.observe(ideal, CAMERA, rng=np.random.default_rng(0))
    assert noisy.shape == ideal.depth.shape
    assert noisy.dtype == np.float32
    assert (ideal.depth == np.float32(0.6)).all()  # the ideal image is shared by all sensors
