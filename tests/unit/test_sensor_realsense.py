"""The RealSense model against the measured laws, closed forms and a second, ray-cast camera."""

import numpy as np
import pytest
import trimesh

from doughdata.geometry import points_from_depth, project, quaternion_to_matrix
from doughdata.render.cameras import default_camera
from doughdata.render.depth import DepthRenderer
from doughdata.render.sensors.realsense import (
    RealSense,
    RealSenseConfig,
    correlated_field,
    hidden_from_second_camera,
)
from doughdata.stages import DepthImage
from doughschemas import SEGMENT_TABLE, Camera, ComponentMesh, Intrinsics

# Measured on real table tops at 640 x 480, f = 616 px: distance [m], standard deviation [mm].
MEASURED = [(0.40, 0.34), (0.50, 0.46), (0.60, 0.59), (0.70, 0.73), (0.82, 1.01)]
AUTOCORRELATION = {1: 0.94, 2: 0.87, 4: 0.71, 8: 0.42}


def camera(width: int = 640, height: int = 480) -> Camera:
    """The lens of the measured recordings, at any resolution."""
    scale = width / 640
    lens = Intrinsics(
        width=width,
        height=height,
        fx=616.37 * scale,
        fy=616.37 * scale,
        cx=width / 2,
        cy=height / 2,
    )
    return Camera(intrinsics=lens, position=(0, 0, 1), quaternion=(1, 0, 0, 0))


def plane(depth: float, view: Camera) -> DepthImage:
    """A wall across the optical axis."""
    shape = (view.intrinsics.height, view.intrinsics.width)
    return DepthImage(
        depth=np.full(shape, depth, np.float32), segments=np.full(shape, SEGMENT_TABLE, np.uint8)
    )


def errors(depth: float, view: Camera, draws: int) -> np.ndarray:
    """Depth errors [m] on a wall, (draws, rows, columns), the invalid left band cut off."""
    image, band = plane(depth, view), int(view.intrinsics.fx * 0.05 / depth) + 2
    noisy = [RealSense().observe(image, view, rng=np.random.default_rng(i)) for i in range(draws)]
    seen = np.stack(noisy)[:, :, band:]
    assert (seen > 0).all()
    return seen.astype(float) - depth


def correlation(error: np.ndarray, lag: int, axis: int) -> float:
    """Autocorrelation at a lag along an axis; the true mean is zero."""
    count = error.shape[axis] - lag
    first, second = (np.take(error, np.arange(count) + shift, axis) for shift in (0, lag))
    return float((first * second).mean() / (error**2).mean())


@pytest.mark.parametrize(("depth", "measured"), MEASURED)
def test_noise_matches_measured_table_tops(depth: float, measured: float) -> None:
    """On a wall sigma is the measured one within 12 % and the fitted law within 5 %."""
    error = errors(depth, camera(), 6) * 1e3
    sigma = np.sqrt((error**2).mean())
    assert abs(sigma / measured - 1) < 0.12
    assert abs(sigma / np.hypot(0.26, 1.40 * depth**2) - 1) < 0.05
    assert abs(error.mean()) < 0.1 * sigma


@pytest.mark.parametrize("depth", [0.4, 0.57, 0.82])
def test_autocorrelation_matches_the_measured_one(depth: float) -> None:
    """Along rows and columns the autocorrelation is the measured one within 0.06."""
    error = errors(depth, camera(), 6)
    for lag, measured in AUTOCORRELATION.items():
        for axis in (1, 2):
            assert abs(correlation(error, lag, axis) - measured) < 0.06


def test_noise_is_the_same_at_twice_the_resolution() -> None:
    """At 1280 px the same sigma comes out, and the same correlation at twice the lag."""
    fine, coarse = errors(0.6, camera(1280, 960), 2), errors(0.6, camera(), 6)
    assert abs(fine.std() / coarse.std() - 1) < 0.06
    for lag in AUTOCORRELATION:
        assert abs(correlation(fine, 2 * lag, 2) - correlation(coarse, lag, 2)) < 0.06


def test_disparity_comes_in_steps_of_a_32nd_pixel() -> None:
    """Every valid depth is f B / d with d a whole number of 1/32 px."""
    view = camera()
    noisy = RealSense().observe(plane(0.5, view), view, rng=np.random.default_rng(0))
    steps = 616.37 * 0.05 / noisy[noisy > 0].astype(float) * 32
    assert np.abs(steps - np.rint(steps)).max() < 0.01
    assert len(np.unique(np.rint(steps))) > 3


def test_left_band_has_no_partner() -> None:
    """The columns u < f B / z are invalid and all others of a wall are valid."""
    view = camera()
    noisy = RealSense().observe(plane(0.7, view), view, rng=np.random.default_rng(0))
    band = int(np.ceil(616.37 * 0.05 / 0.7))
    assert (noisy[:, :band] == 0).all()
    assert (noisy[:, band:] > 0).all()


def test_shadow_lies_on_the_left_of_near_things() -> None:
    """A block before a wall has a shadow of f B (1/z_near - 1/z_far) px at its left, none right."""
    view, near, far = camera(), 0.5, 0.7
    image = plane(far, view)
    image.depth[100:300, 300:400] = near
    noisy = RealSense().observe(image, view, rng=np.random.default_rng(0))
    width = 616.37 * 0.05 * (1 / near - 1 / far)
    row = noisy[200] == 0
    row[:60] = False  # the left band
    assert abs(row.sum() - width) <= 1
    assert row[300 - int(width) : 300].all()
    assert not row[300:].any()
    assert not (noisy[50, 60:] == 0).any()


def test_too_near_and_unseen_pixels_are_invalid() -> None:
    """Beyond the search range, and where the ideal camera hits nothing, depth is 0."""
    view = camera()
    near = RealSense().observe(plane(0.2, view), view, rng=np.random.default_rng(0))
    nothing = RealSense().observe(plane(0.0, view), view, rng=np.random.default_rng(0))
    assert (near == 0).all()  # 154 px of disparity, 126 are searched
    assert (nothing == 0).all()


def test_same_generator_same_image() -> None:
    """The noise depends on the generator alone."""
    view = camera()
    first, second, other = (
        RealSense().observe(plane(0.6, view), view, rng=np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_without_noise_only_rounding_is_left() -> None:
    """With both sigmas zero the error is at most half a disparity step."""
    view, config = camera(), RealSenseConfig(sigma_constant=0.0, sigma_quadratic=0.0)
    ramp = plane(0.5, view)
    ramp.depth[:] = np.linspace(0.45, 0.75, 480, dtype=np.float32)[:, None]
    noisy = RealSense(config).observe(ramp, view, rng=np.random.default_rng(0))
    step = ramp.depth**2 / (616.37 * 0.05) / 32
    valid = noisy > 0
    assert valid[:, 80:].all()
    assert (np.abs(noisy - ramp.depth)[valid] <= 0.51 * step[valid]).all()


def test_hidden_pixels_are_those_a_second_camera_does_not_see() -> None:
    """Casting rays from the right camera agrees on 99 % of pixels and on most of the shadow."""
    ring = trimesh.creation.torus(0.04, 0.015, major_sections=128, minor_sections=64)
    ring.apply_translation([0, 0, 0.015])
    block = trimesh.creation.box(extents=[0.02, 0.02, 0.05])
    block.apply_translation([0.05, 0.08, 0.025])
    parts = [
        ComponentMesh(
            vertices=np.asarray(m.vertices, np.float32), faces=np.asarray(m.faces, np.uint32)
        )
        for m in (ring, block)
    ]
    left = default_camera()
    right_axis = quaternion_to_matrix(np.array(left.quaternion))[:, 0]
    x, y, z = np.array(left.position) + 0.05 * right_axis
    right = Camera(intrinsics=left.intrinsics, position=(x, y, z), quaternion=left.quaternion)
    seen, partner = DepthRenderer().render(parts, [], [left, right])
    disparity = (left.intrinsics.fx * 0.05 / seen.depth).astype(np.float32)
    pixels, depth = project(points_from_depth(seen.depth, left), right)
    column, row = np.rint(pixels).astype(int).T
    inside = pixels[:, 0] >= 0
    there = partner.depth[row, np.clip(column, 0, None)]
    truth = (~inside | (there < depth - 0.004)).reshape(seen.depth.shape)
    ours = hidden_from_second_camera(disparity)
    assert (ours == truth).mean() > 0.995
    shadow = truth & (np.arange(640) > 80)
    assert shadow.sum() > 300
    assert ours[shadow].mean() > 0.8


def test_correlated_field_has_unit_variance_and_the_asked_correlation() -> None:
    """Over many draws the variance is 1 and the autocorrelation exp(-(lag / length)^power)."""
    rng = np.random.default_rng(0)
    fields = np.stack([correlated_field((90, 110), rng, length=5.0, power=1.3) for _ in range(80)])
    assert fields.shape == (80, 90, 110)
    assert abs((fields**2).mean() - 1) < 0.03
    for lag in (1, 3, 6, 12):
        for axis in (1, 2):
            expected = np.exp(-((lag / 5.0) ** 1.3))
            assert abs(correlation(fields, lag, axis) - expected) < 0.03
    # The torus is wide enough: opposite edges know nothing of each other.
    assert abs((fields[:, 0] * fields[:, -1]).mean()) < 0.06
