"""The Kinect model against the published formulas, on planes and outlines in closed form."""

import math

import numpy as np
import pytest

from doughdata.geometry import pixel_rays
from doughdata.render.incidence import incidence_angle
from doughdata.render.sensors.kinect import Kinect, KinectConfig
from doughdata.stages import DepthImage, Sensor
from doughschemas import SEGMENT_TABLE, Camera, Intrinsics

STILL = {"axial": 0.0, "axial_quadratic": 0.0, "axial_angle": 0.0}


def camera(focal: float = 580.0, width: int = 640, height: int = 480) -> Camera:
    """A lens at the origin that looks along z."""
    lens = Intrinsics(
        width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2
    )
    return Camera(intrinsics=lens, position=(0, 0, 0), quaternion=(0, 0, 0, 1))


def image(depth: np.ndarray) -> DepthImage:
    """An image of the table."""
    return DepthImage(
        depth=depth.astype(np.float32), segments=np.full(depth.shape, SEGMENT_TABLE, np.uint8)
    )


def plane(distance: float, degrees: float, view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] and incidence angle [rad] of a plane through (0, 0, distance) turned about y."""
    turn = math.radians(degrees)
    normal = np.array([math.sin(turn), 0.0, math.cos(turn)])
    rays = pixel_rays(view.intrinsics)
    across = rays @ normal
    angle = np.arccos(across / np.linalg.norm(rays, axis=-1))
    return distance * normal[2] / across, angle


def observe(depth: np.ndarray, view: Camera, seed: int = 0, **constants: float) -> np.ndarray:
    """One observation, in float64."""
    sensor = Kinect(KinectConfig(**constants))
    return sensor.observe(image(depth), view, rng=np.random.default_rng(seed)).astype(float)


def sigma(depth: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Nguyen, Izadi and Lovell (2012), equation for the axial noise [m]."""
    tilt = angle / (math.pi / 2 - angle)
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2 + 0.0001 / np.sqrt(depth) * tilt**2


@pytest.mark.parametrize("distance", [0.4, 0.5, 0.7, 0.85, 1.0])
def test_noise_follows_the_formula(distance: float) -> None:
    """On a wall the deviation is the formula's within 3 %, without bias."""
    view = camera(focal=2400.0)
    depth, angle = plane(distance, 0.0, view)
    error = observe(depth, view) - depth
    assert abs(error.std() / sigma(depth, angle).mean() - 1) < 0.03
    assert abs(error.mean()) < 0.02 * error.std()


@pytest.mark.parametrize("degrees", [20.0, 45.0, 60.0, 75.0, 80.0])
@pytest.mark.parametrize("distance", [0.5, 1.0])
def test_noise_grows_with_the_angle(degrees: float, distance: float) -> None:
    """On a turned plane each pixel's error is the formula's at its own depth and angle."""
    view = camera(focal=6000.0)
    depth, angle = plane(distance, degrees, view)
    error = (observe(depth, view, angle_max=1.55, range_min=0.1) - depth) / sigma(depth, angle)
    assert abs(error.std() - 1) < 0.03
    assert abs(error.mean()) < 0.02


def test_shifts_leave_planes_alone() -> None:
    """Without axial noise a turned plane comes back as it is: lateral noise is about outlines."""
    view = camera()
    depth, _ = plane(0.8, 50.0, view)
    depth = np.where(depth < 2.0, depth, 0.0)
    still = observe(depth, view, **STILL)
    seen = (depth > 0.45) & (depth < 1.5)
    assert (still[seen] > 0).all()
    assert np.abs(still[seen] / depth[seen] - 1).max() < 1e-4


def test_outlines_are_ragged_by_the_lateral_sigma() -> None:
    """Of the pixels k beside an outline a share of Q((k + 1/2) / 0.8) sees the other side."""
    view = camera(focal=4000.0)
    depth = np.full((480, 640), 0.7)
    depth[:, :320] = 0.5
    seen = np.stack([observe(depth, view, seed=i, **STILL) for i in range(10)])
    for k in range(4):
        expected = 0.5 * math.erfc((k + 0.5) / 0.8 / math.sqrt(2))
        assert abs((seen[:, :, 320 + k] < 0.6).mean() - expected) < 0.03
        assert abs((seen[:, :, 319 - k] > 0.6).mean() - expected) < 0.03


def test_steep_near_and_unseen_surfaces_are_invalid() -> None:
    """Beyond 82 degrees, nearer than 0.4 m and where the ideal camera sees nothing, depth is 0."""
    view = camera(focal=30_000.0)
    steep, _ = plane(0.6, 84.0, view)
    fair, _ = plane(0.6, 78.0, view)
    assert (observe(steep, view) == 0).all()
    assert (observe(fair, view) > 0).all()
    assert (observe(np.full((480, 640), 0.39), view) == 0).all()
    hole = np.full((480, 640), 0.6)
    hole[100:200, 100:200] = 0.0
    assert (observe(hole, view)[hole == 0] == 0).all()


def test_noise_depends_on_the_generator_alone() -> None:
    """The same generator gives the same bytes, another one others; numpy's global one is unused."""
    view = camera()
    depth, _ = plane(0.6, 30.0, view)
    before = np.random.get_state()[1].copy()
    first, second, other = (observe(depth, view, seed=seed) for seed in (1, 1, 2))
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != other.tobytes()
    assert np.array_equal(np.random.get_state()[1], before)


def test_sensor_keeps_the_contract() -> None:
    """It needs no arguments, returns float32 of the image's shape and leaves the image alone."""
    sensor, view = Kinect(), camera()
    ideal = image(np.full((480, 640), 0.6))
    ideal.depth.setflags(write=False)
    noisy = sensor.observe(ideal, view, rng=np.random.default_rng(0))
    assert isinstance(sensor, Sensor)
    assert (noisy.dtype, noisy.shape) == (np.float32, (480, 640))


@pytest.mark.parametrize("degrees", [0.0, 30.0, 70.0])
def test_incidence_of_planes(degrees: float) -> None:
    """The angle of a turned plane is exact in every pixel that sees it."""
    view = camera()
    depth, angle = plane(0.7, degrees, view)
    depth = np.where((depth > 0) & (depth < 5), depth, 0.0)
    found = incidence_angle(depth.astype(np.float32), view)
    assert np.abs(found - angle)[depth > 0].max() < 0.01


def test_incidence_of_a_sphere() -> None:
    """On a sphere of 100 mm half a metre away the angle is that of the closed form within 1.5 deg.

    Its rim, beyond 70 degrees, is left out: there one pixel spans several degrees.
    """
    view = camera()
    rays, centre, radius = pixel_rays(view.intrinsics), np.array([0.0, 0.0, 0.5]), 0.1
    square, along = (rays**2).sum(-1), rays @ centre
    root = along**2 - square * (centre @ centre - radius**2)
    depth = np.where(root > 0, (along - np.sqrt(np.maximum(root, 0))) / square, 0.0)
    normal = (rays * depth[..., None] - centre) / radius
    angle = np.arccos(np.clip(-(normal * rays).sum(-1) / np.sqrt(square), -1, 1))
    found = incidence_angle(depth.astype(np.float32), view)
    inside = (root > 0) & (angle < math.radians(70))
    assert inside.sum() > 10_000
    assert np.degrees(np.abs(found - angle)[inside]).max() < 1.5
    assert (found[root <= 0] == np.float32(math.pi / 2)).all()
