"""The flat view of the contact sheet against geometry and scipy."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from doughdata.view.projection import View, convex_outline, shaded_faces


@pytest.mark.parametrize("angles", [(0.0, 0.0), (-1.1, 0.6), (2.5, 1.5)])
def test_view_is_a_rotation_with_world_up_upwards(angles: tuple[float, float]) -> None:
    """Right, up and towards the viewer form a right-handed frame, and world z points up."""
    view = View(azimuth=angles[0], elevation=angles[1])
    assert np.allclose(view.axes @ view.axes.T, np.eye(3))
    assert np.isclose(np.linalg.det(view.axes), 1.0)
    picture, _ = view.project(np.array([[0.0, 0.0, 1.0]]))
    assert abs(picture[0, 0]) < 1e-12
    assert picture[0, 1] > 0


def test_nearness_grows_towards_the_viewer() -> None:
    """Of two points behind each other the nearer one has the larger nearness and the same place."""
    view = View()
    picture, near = view.project(np.array([[0.0, 0.0, 0.0], view.axes[2] * 0.1]))
    assert np.allclose(picture[0], picture[1])
    assert np.isclose(near[1] - near[0], 0.1)


def test_only_faces_towards_the_viewer_are_drawn() -> None:
    """Of a sphere about half the faces are drawn, all nearer than its centre, colours in 0..1."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners, rgb, near = shaded_faces(ball.vertices, ball.faces, np.array([0.2, 0.5, 0.8]), View())
    assert corners.shape == (len(near), 3, 2)
    assert abs(len(near) / len(ball.faces) - 0.5) < 0.02
    assert near.min() > -0.1
    assert rgb.min() >= 0
    assert rgb.max() <= 1


def test_degenerate_faces_are_left_out() -> None:
    """A triangle without area gives no face and no NaN."""
    corners, rgb, near = shaded_faces(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.ones(3), View())
    assert len(corners) == len(rgb) == len(near) == 0


def test_outline_is_scipys_convex_hull() -> None:
    """The outline of random points has the corners, area and orientation of scipy's hull."""
    rng = np.random.default_rng(0)
    for count in (3, 10, 200):
        points = rng.normal(size=(count, 2))
        outline, hull = convex_outline(points), ConvexHull(points)
        assert {tuple(p) for p in outline} == {tuple(p) for p in points[hull.vertices]}
        x, y = outline.T
        area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
        assert np.isclose(area, hull.volume)


def test_outline_drops_points_on_edges() -> None:
    """Of a square with points on its sides only the four corners stay."""
    side = np.linspace(0, 1, 5)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    assert sorted(map(tuple, convex_outline(grid))) == [(0, 0), (0, 1), (1, 0), (1, 1)]
