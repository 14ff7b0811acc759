"""Active stereo against closed forms and against a second, ray-cast camera."""

import numpy as np
import pytest
import trimesh

from doughdata.geometry import pixel_rays, points_from_depth, project, quaternion_to_matrix
from doughdata.render.cameras import default_camera
from doughdata.render.depth import DepthRenderer
from doughdata.render.sensors.stereo import Stereo, StereoConfig, second_view
from doughdata.stages import DepthImage, Sensor
from doughschemas import SEGMENT_TABLE, Camera, ComponentMesh, Intrinsics

FOCAL, BASELINE = 616.37, 0.05


def camera() -> Camera:
    """The lens of real recordings, 640 x 480."""
    lens = Intrinsics(width=640, height=480, fx=FOCAL, fy=FOCAL, cx=320, cy=240)
    return Camera(intrinsics=lens, position=(0, 0, 0), quaternion=(0, 0, 0, 1))


def observe(depth: np.ndarray, seed: int = 0, **constants: float) -> np.ndarray:
    """One observation with changed constants, in float64."""
    image = DepthImage(
        depth=depth.astype(np.float32), segments=np.full(depth.shape, SEGMENT_TABLE, np.uint8)
    )
    sensor = Stereo(StereoConfig(**constants))  # type: ignore[arg-type]
    return sensor.observe(image, camera(), rng=np.random.default_rng(seed)).astype(float)


def wall(distance: float) -> np.ndarray:
    """Depth [m] of a wall."""
    return np.full((480, 640), distance)


def slope(distance: float, degrees: float) -> np.ndarray:
    """Depth [m] of a plane through (0, 0, distance) turned about x."""
    return distance / (1 + np.tan(np.radians(degrees)) * pixel_rays(camera().intrinsics)[..., 1])


@pytest.mark.parametrize("distance", [0.4, 0.55, 0.7, 0.85, 1.0])
def test_depth_of_a_wall_is_right(distance: float) -> None:
    """Where the second camera looks, over 98 % are measured, with a bias below 1 %."""
    noisy = observe(wall(distance))[:, int(FOCAL * BASELINE / distance) + 4 :]
    valid = noisy > 0
    assert valid.mean() > 0.98
    assert abs(noisy[valid].mean() / distance - 1) < 0.01
    assert abs(np.median(noisy[valid]) / distance - 1) < 0.01


def test_disparity_comes_in_sixteenths() -> None:
    """Every valid depth is f B / d with d a whole number of 1/16 px."""
    noisy = observe(slope(0.6, 30.0))
    steps = FOCAL * BASELINE / noisy[noisy > 0] * 16
    assert np.abs(steps - np.rint(steps)).max() < 0.01


def test_depth_of_a_slope_is_terraced() -> None:
    """A slope whose depth has a value a row comes out in fewer levels, unevenly filled.

    The ideal disparities fill their histogram evenly. The matcher prefers some fractions of a
    pixel, so the counts of the 16 fractions scatter far more than even ones of that many pixels.
    """
    ideal = slope(0.6, 40.0)
    noisy = observe(ideal)
    near = (noisy > 0) & (np.abs(noisy / ideal - 1) < 0.02)
    assert near.mean() > 0.8
    truth = FOCAL * BASELINE / ideal[near]
    found = FOCAL * BASELINE / noisy[near]
    counts, even = (
        np.bincount(np.rint(16 * (d % 1)).astype(int) % 16, minlength=16) for d in (found, truth)
    )
    assert counts.std() / counts.mean() > 3 * even.std() / even.mean()
    assert len(np.unique(np.rint(16 * found))) < len(np.unique(ideal)) * 2
    assert np.abs(found - truth).mean() < 0.25  # yet it follows the slope


def test_shadow_is_on_the_left_alone() -> None:
    """A block before a wall has a shadow of f B (1/z_near - 1/z_far) px at its left alone.

    At its right single pixels fail, where half the matcher's window hangs over the outline.
    """
    near, far = 0.5, 0.7
    depth = wall(far)
    depth[100:300, 300:400] = near
    missing = (observe(depth) == 0)[120:280]
    missing[:, : int(FOCAL * BASELINE / far) + 4] = False
    width = FOCAL * BASELINE * (1 / near - 1 / far)
    assert missing[:, 300 - round(width) - 5 : 305].sum(axis=1).mean() == pytest.approx(
        width, abs=4
    )
    assert missing[:, 300 - round(width) + 4 : 296].mean() > 0.9
    assert missing[:, 390:430].sum(axis=1).mean() < 0.2 * width
    assert not missing[:, 404:430].any()


def test_nothing_is_invented() -> None:
    """Depth is 0 where the ideal camera sees nothing, and mostly without a partner or too near."""
    hole = wall(0.6)
    hole[200:300, 250:400] = 0.0
    assert (observe(hole)[hole == 0] == 0).all()
    assert (observe(wall(0.0)) == 0).all()
    assert (observe(wall(0.6))[:, : int(FOCAL * BASELINE / 0.6)] == 0).mean() > 0.98
    assert (observe(wall(0.2)) == 0).mean() > 0.8  # 154 px of disparity, 126 are searched


def test_without_dots_nothing_matches() -> None:
    """A wall without texture is measured right in a small share of its pixels alone."""
    right = np.abs(observe(wall(0.6), gain=0.0) / 0.6 - 1) < 0.01
    assert right.mean() < 0.2


def test_noise_depends_on_the_generator_alone() -> None:
    """The same generator gives the same bytes, another one others; numpy's global one is unused."""
    before = np.random.get_state()[1].copy()
    first, second, other = (observe(slope(0.6, 20.0), seed=seed) for seed in (1, 1, 2))
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != other.tobytes()
    assert np.array_equal(np.random.get_state()[1], before)


def test_sensor_keeps_the_contract() -> None:
    """It needs no arguments, works at any resolution and leaves the image alone."""
    sensor, view = Stereo(), default_camera()
    shape = (view.intrinsics.height, view.intrinsics.width)
    depth = np.full(shape, 0.6, np.float32)
    depth.setflags(write=False)
    image = DepthImage(depth=depth, segments=np.full(shape, SEGMENT_TABLE, np.uint8))
    noisy = sensor.observe(image, view, rng=np.random.default_rng(0))
    assert isinstance(sensor, Sensor)
    assert (noisy.dtype, noisy.shape) == (np.float32, shape)


@pytest.mark.parametrize("gradient", [-0.3, -0.05, 0.0, 0.05, 0.3])
def test_second_view_of_a_plane(gradient: float) -> None:
    """Disparity a + b u seen from the first camera is (a + b k) / (1 - b) from the second."""
    u = np.arange(400.0)
    disparity = np.broadcast_to(150.0 + gradient * (u - 200.0), (3, 400)).astype(np.float32)
    seen, source = second_view(disparity)
    expected = (150.0 + gradient * (u - 200.0)) / (1 - gradient)
    last = int((u - disparity[0])[-1])
    inside = (u > (u - disparity[0])[0] + 1) & (u < last) & (u >= 0)
    assert inside.sum() > 100
    assert np.abs(seen[:, inside] - expected[inside]).max() < 1e-3
    assert np.abs(source[:, inside] - (u + expected)[inside]).max() <= 0.5 + 1e-3


def test_second_view_is_what_a_second_camera_sees() -> None:
    """Casting rays from the right camera gives the same disparity on 97 % of pixels."""
    ring = trimesh.creation.torus(0.04, 0.015, major_sections=128, minor_sections=64)
    ring.apply_translation([0, 0, 0.015])
    part = ComponentMesh(
        vertices=np.asarray(ring.vertices, np.float32), faces=np.asarray(ring.faces, np.uint32)
    )
    left = default_camera()
    x, y, z = (
        np.array(left.position) + BASELINE * quaternion_to_matrix(np.array(left.quaternion))[:, 0]
    )
    right = Camera(intrinsics=left.intrinsics, position=(x, y, z), quaternion=left.quaternion)
    here, there = DepthRenderer().render([part], [], [left, right])
    focal_baseline = np.float32(left.intrinsics.fx * BASELINE)
    seen, _ = second_view(focal_baseline / here.depth)
    truth = focal_baseline / there.depth
    known = np.arange(640) < 640 - truth.max() - 1  # the rest lies outside the first picture
    close = np.abs(seen - truth)[:, known] < 0.1
    assert close.mean() > 0.97
    # Where the first camera sees what the second one does, it is nearly always right.
    pixels, depth = project(points_from_depth(there.depth, right), left)
    column, row = np.rint(pixels).astype(int).T
    visible = here.depth[np.clip(row, 0, 359), np.clip(column, 0, 639)] > depth - 0.002
    assert close[visible.reshape(truth.shape)[:, known]].mean() > 0.985
