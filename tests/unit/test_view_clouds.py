"""Depth windows against the whole image, and the depth colours against matplotlib's."""

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from doughdata.geometry import pixel_rays, project, transform_points
from doughdata.render.cameras import default_camera, look_at
from doughdata.view.clouds import RAMP, depth_windows, ramp_colours, window_points
from doughschemas import Camera, DepthViews

UNIT = 1e-4


def table_views(*cameras: Camera) -> DepthViews:
    """What cameras measure of an empty table: closed form, each ray met with the plane z = 0."""
    images = []
    for camera in cameras:
        rays = transform_points(pixel_rays(camera.intrinsics).reshape(-1, 3), np.zeros(3),
                                np.array(camera.quaternion))  # fmt: skip
        depth = np.where(rays[:, 2] < 0, -camera.position[2] / np.minimum(rays[:, 2], -1e-9), 0)
        shape = (camera.intrinsics.height, camera.intrinsics.width)
        images.append(np.where(depth < 5, np.rint(depth / UNIT), 0).reshape(shape))
    count = len(cameras)
    return DepthViews(
        depth=np.array(images, np.uint16),
        segments=np.ones((count, *images[0].shape), np.uint8),
        frame_index=np.arange(count, dtype=np.int32),
        view_index=np.zeros(count, np.int32),
        cameras=cameras,
        depth_unit=UNIT,
    )


def dough(x: float, y: float) -> np.ndarray:
    """Corners of 20 x 20 x 10 mm of dough on the table."""
    return np.array([[x, y, 0.0], [x + 0.02, y + 0.02, 0.01]])


PLACE = st.floats(-0.05, 0.05)


@settings(deadline=None, max_examples=15)
@given(PLACE, PLACE)
def test_a_window_has_the_points_of_its_pixels(x: float, y: float) -> None:
    """Points of a crop lie on the table, are pixels of the image, and reach round the dough."""
    views = table_views(default_camera())
    (window,) = depth_windows(views, dough(x, y))
    points = window_points(window, unit=UNIT)
    assert window.stride == 1
    assert np.abs(points[:, 2]).max() < UNIT
    pixels, depth = project(points, views.cameras[0])
    columns, rows = np.rint(pixels).astype(int).T
    assert np.abs(pixels - np.rint(pixels)).max() < 1e-6
    assert np.allclose(views.depth[0][rows, columns] * UNIT, depth)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    assert (low <= [x - 0.01, y - 0.01]).all()
    assert (high >= [x + 0.03, y + 0.03]).all()


@settings(deadline=None, max_examples=25)
@given(st.integers(500, 60_000))
def test_the_stride_keeps_the_budget(most: int) -> None:
    """Views together have no more pixels than asked for, a row and a column each apart."""
    views = table_views(default_camera(), default_camera())
    full = sum(window.depth.size for window in depth_windows(views, dough(0, 0)))
    windows = depth_windows(views, dough(0, 0), most_pixels=most)
    stride = windows[0].stride
    edges = sum(sum(window.depth.shape) for window in windows)
    assert sum(window.depth.size for window in windows) <= most + edges
    assert stride == 1 or full / (stride - 1) ** 2 > most
    spaced = window_points(windows[0], unit=UNIT)
    pixels, _ = project(spaced, views.cameras[0])
    assert np.abs(pixels - np.rint(pixels)).max() < 0.05  # every point is a pixel of the image
    columns = np.unique(np.rint(pixels[:, 0]))
    assert len(columns) < 2 or np.diff(columns).min() == stride


def test_a_camera_inside_the_scene_keeps_its_whole_image() -> None:
    """Where a corner of the surroundings is behind the camera, nothing is cut off."""
    camera = look_at(default_camera().intrinsics, (0.0, 0.0, 0.03), (0.05, 0.0, 0.0))
    (window,) = depth_windows(table_views(camera), dough(-0.05, 0.0))
    assert window.depth.shape == (camera.intrinsics.height, camera.intrinsics.width)


def test_a_camera_that_looks_elsewhere_gives_no_window() -> None:
    """A view without a single pixel of the dough's surroundings is left out."""
    camera = look_at(default_camera().intrinsics, (0.5, 0.0, 0.3), (0.5, 3.0, 0.3))
    away = dough(-0.5, 3.0) - [5.0, 0.0, 0.0]
    _, depth = project(away, camera)
    assert (depth > 0).all()
    assert depth_windows(table_views(camera), away) == []


def test_depth_colours_are_those_of_the_sheet() -> None:
    """The stops are matplotlib's reversed viridis, and between them the error is small."""
    viridis = mpl.colormaps["viridis_r"]
    at = np.linspace(0, 1, len(RAMP))
    assert np.abs(RAMP - viridis(at)[:, :3]).max() < 0.005
    fine = np.linspace(0, 1, 201)
    assert np.abs(ramp_colours(fine) - viridis(fine)[:, :3]).max() < 0.03
    assert ramp_colours(np.array([-1.0, 2.0])) == pytest.approx(RAMP[[0, -1]])
