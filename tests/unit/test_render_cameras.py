"""The default camera, jitter and camera files."""

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from doughdata.geometry import pixel_rays, project, quaternion_to_matrix
from doughdata.render.cameras import (
    PAPER_INTRINSICS,
    camera_from_json,
    camera_to_json,
    default_camera,
    jittered,
    look_at,
    read_camera,
    scaled,
)
from doughschemas import BadInputError, Intrinsics

SMALL = Intrinsics(width=64, height=48, fx=60.0, fy=61.0, cx=31.0, cy=24.0)


def good() -> dict[str, Any]:
    """A valid camera file."""
    return camera_to_json(default_camera())


def test_default_camera_sees_the_whole_workspace() -> None:
    """Every corner of 200 x 200 x 100 mm over the origin lies in the picture, about 0.57 m away."""
    camera = default_camera()
    corners = np.array(list(itertools.product([-0.1, 0.1], [-0.1, 0.1], [0.0, 0.1])))
    pixels, depth = project(corners, camera)
    assert (depth > 0.3).all()
    assert (pixels > 0).all()
    assert (pixels < [camera.intrinsics.width - 1, camera.intrinsics.height - 1]).all()
    assert abs(np.linalg.norm(camera.position) - 0.57) < 0.005


def test_default_camera_stands_upright() -> None:
    """World up points up in the picture (towards smaller rows)."""
    pixels, _ = project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]), default_camera())
    assert pixels[1, 1] < pixels[0, 1] - 10


def test_scaling_keeps_the_field_of_view() -> None:
    """The rays through the picture's edges are the same at full size and at a third."""
    small = scaled(PAPER_INTRINSICS, 1 / 3)
    assert (small.width, small.height) == (640, 360)
    for full, third, size in (
        ((PAPER_INTRINSICS.fx, PAPER_INTRINSICS.cx), (small.fx, small.cx), (1920, 640)),
        ((PAPER_INTRINSICS.fy, PAPER_INTRINSICS.cy), (small.fy, small.cy), (1080, 360)),
    ):
        for share in (0.0, 0.3, 1.0):
            edges = [share * pixels - 0.5 for pixels in size]
            slopes = [(e - c) / f for e, (f, c) in zip(edges, (full, third), strict=True)]
            assert math.isclose(slopes[0], slopes[1], abs_tol=1e-12)


def test_rays_have_unit_depth_and_meet_the_principal_point() -> None:
    """All rays have z = 1 and the one through the principal point is the optical axis."""
    rays = pixel_rays(SMALL)
    assert rays.shape == (48, 64, 3)
    assert (rays[..., 2] == 1).all()
    assert np.allclose(rays[24, 31], [0, 0, 1])


@pytest.mark.parametrize("position", [(0.3, -0.2, 0.5), (0.0, 0.0, 0.6), (-1.0, 0.0, 0.1)])
def test_look_at_centres_its_target(position: tuple[float, float, float]) -> None:
    """The target falls on the principal point and the horizon is level."""
    camera = look_at(SMALL, position, (0.01, 0.02, 0.03))
    pixels, depth = project(np.array([[0.01, 0.02, 0.03]]), camera)
    assert np.allclose(pixels, [[SMALL.cx, SMALL.cy]], atol=1e-9)
    assert math.isclose(depth[0], math.dist(position, (0.01, 0.02, 0.03)))
    matrix = quaternion_to_matrix(np.array(camera.quaternion))
    assert abs(matrix[2, 0]) < 1e-12
    assert math.isclose(float(np.linalg.det(matrix)), 1.0)


def test_looking_at_itself_is_refused() -> None:
    """A target at the camera's own position raises."""
    with pytest.raises(BadInputError, match="look at itself"):
        look_at(SMALL, (0.1, 0.1, 0.1), (0.1, 0.1, 0.1))


def test_jitter_has_the_given_spread() -> None:
    """Over 3,000 draws position and angle have the asked standard deviations within 5 %."""
    camera, rng = default_camera(), np.random.default_rng(0)
    draws = [jittered(camera, rng) for _ in range(3000)]
    offsets = np.array([draw.position for draw in draws]) - camera.position
    base = quaternion_to_matrix(np.array(camera.quaternion))
    turns = base.T @ quaternion_to_matrix(np.array([draw.quaternion for draw in draws]))
    # For small angles the rotation vector is the antisymmetric part of the matrix.
    angles = np.stack(
        [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0],
         turns[:, 1, 0] - turns[:, 0, 1]], axis=1,
    ) / 2  # fmt: skip
    assert np.allclose(offsets.std(axis=0), 0.010, rtol=0.05)
    assert np.allclose(np.degrees(angles.std(axis=0)), 1.0, rtol=0.05)
    assert np.abs(offsets.mean(axis=0)).max() < 0.001


def test_no_jitter_keeps_the_camera() -> None:
    """With both sigmas zero the pose stays the same."""
    camera = default_camera()
    same = jittered(camera, np.random.default_rng(0), position_sigma=0.0, angle_sigma=0.0)
    assert same.position == camera.position
    assert np.allclose(same.quaternion, np.array(camera.quaternion) * np.sign(camera.quaternion[3]))


def test_json_round_trip(tmp_path: Path) -> None:
    """A camera written as JSON text and read from the file is equal."""
    camera = jittered(default_camera(), np.random.default_rng(5))
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera_to_json(camera)))
    assert read_camera(path) == camera


def test_json_may_say_look_at() -> None:
    """`look_at` instead of a quaternion gives the camera of `look_at`."""
    data = {**good(), "look_at": [0, 0, 0]}
    del data["quaternion"]
    camera = camera_from_json(data)
    assert camera == look_at(camera.intrinsics, camera.position)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal": 3}, "unknown field 'focal'"),
        ({"position": None}, "position must be 3 numbers"),
        ({"position": [0, 0]}, "position must be 3 numbers"),
        ({"position": [0, 0, float("nan")]}, "position must be 3 numbers"),
        ({"quaternion": [0, 0, 0, 2]}, "length 1"),
        ({"quaternion": ["a", 0, 0, 1]}, "quaternion must be 4 numbers"),
        ({"look_at": [0, 0, 0]}, "not both"),
        ({"intrinsics": {"width": 640}}, "intrinsics must hold exactly"),
        ({"intrinsics": None}, "intrinsics must hold exactly"),
        ({"intrinsics": {**good()["intrinsics"], "fx": -1}}, "fx and fy must be positive"),
        ({"intrinsics": {**good()["intrinsics"], "width": 0}}, "width and height"),
        ({"intrinsics": {**good()["intrinsics"], "width": 10.5}}, "width and height"),
        ({"intrinsics": {**good()["intrinsics"], "cx": "1"}}, "intrinsics must be 6 numbers"),
    ],
)
def test_bad_camera_says_what_is_wrong(change: dict[str, Any], message: str) -> None:
    """Each wrong field raises one line that names it."""
    with pytest.raises(BadInputError, match=message) as caught:
        camera_from_json({**good(), **change})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", '"camera"', "null"])
def test_file_without_a_camera_is_refused(tmp_path: Path, text: str) -> None:
    """Text that is no JSON object raises one line with the file's name."""
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(BadInputError, match=r"bad\.json") as caught:
        read_camera(path)
    assert "\n" not in str(caught.value)


def test_missing_and_binary_files_are_refused(tmp_path: Path) -> None:
    """A missing file, a folder and a binary file raise BadInputError."""
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x80")
    for path in (tmp_path / "none.json", tmp_path, tmp_path / "binary.json"):
        with pytest.raises(BadInputError, match="camera file"):
            read_camera(path)
