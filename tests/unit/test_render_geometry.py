"""Rotations and pinhole geometry against scipy and against each other."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doughdata.geometry import (
    matrix_to_quaternion,
    points_from_depth,
    project,
    quaternion_to_matrix,
    rotation_vector_to_matrix,
    transform_points,
)
from doughdata.render.cameras import default_camera


def test_quaternions_match_scipy() -> None:
    """Random quaternions of any length give scipy's matrices."""
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    ours = quaternion_to_matrix(quaternions)
    assert np.allclose(ours, Rotation.from_quat(quaternions).as_matrix(), atol=1e-12)


def test_zero_quaternion_is_refused() -> None:
    """A quaternion of length zero raises instead of giving NaN."""
    with pytest.raises(ValueError, match="length zero"):
        quaternion_to_matrix(np.zeros(4))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi / 2, np.pi - 1e-9, np.pi])
def test_matrix_to_quaternion_inverts(angle: float) -> None:
    """Matrix -> quaternion -> matrix is the identity, also at half turns."""
    for axis in np.vstack([np.eye(3), np.random.default_rng(1).normal(size=(5, 3))]):
        matrix = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        quaternion = matrix_to_quaternion(matrix)
        assert quaternion[3] >= 0
        assert np.allclose(quaternion_to_matrix(quaternion), matrix, atol=1e-9)


def test_rotation_vectors_match_scipy() -> None:
    """Rotation vectors from zero to several turns give scipy's matrices."""
    vectors = [np.zeros(3), *np.random.default_rng(2).normal(size=(20, 3)) * 3]
    for vector in vectors:
        expected = Rotation.from_rotvec(vector).as_matrix()
        assert np.allclose(rotation_vector_to_matrix(vector), expected, atol=1e-12)


def test_back_projection_inverts_projection() -> None:
    """The points of a depth image project back onto their own pixels and depths."""
    camera = default_camera()
    shape = (camera.intrinsics.height, camera.intrinsics.width)
    rng = np.random.default_rng(3)
    depth = np.where(rng.random(shape) < 0.1, 0, rng.uniform(0.3, 1.0, shape)).astype(np.float32)
    mask = rng.random(shape) < 0.5
    rows, columns = np.nonzero((depth > 0) & mask)
    points = points_from_depth(depth, camera, mask)
    pixels, z = project(points, camera)
    assert np.allclose(pixels, np.stack([columns, rows], axis=1), atol=1e-6)
    assert np.allclose(z, depth[rows, columns], atol=1e-9)


def test_depth_of_another_size_is_refused() -> None:
    """An image that is not the camera's size raises and names both sizes."""
    with pytest.raises(ValueError, match=r"\(360, 640\), got \(10, 10\)"):
        points_from_depth(np.ones((10, 10)), default_camera())


def test_transform_applies_rotation_then_translation() -> None:
    """A posed point is R p + t, as scipy computes it."""
    rng = np.random.default_rng(4)
    points, position, quaternion = rng.normal(size=(7, 3)), rng.normal(size=3), rng.normal(size=4)
    expected = Rotation.from_quat(quaternion).apply(points) + position
    assert np.allclose(transform_points(points, position, quaternion), expected)
