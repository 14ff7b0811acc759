"""Real pixels and real dough (tests/data/recordings/NOTICE.md says whose)."""

from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from doughdata.dataset import open_dataset
from doughdata.geometry import pixel_rays
from doughdata.recordings.cloud import Cloud
from doughdata.recordings.colour import colour_range
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.options import ProcessingConfig
from doughdata.torch import DoughDataset
from doughschemas import SEGMENT_COMPONENT

DATA = Path(__file__).parents[1] / "data" / "recordings"
MUG, RING = DATA / "red_mug.mcap", DATA / "dough_ring.ply"


def standard_reader():
    """Depth images [mm] and the first calibration, by the standard reader and OpenCV alone."""
    depths, info = [], None
    with MUG.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, value in reader.iter_decoded_messages():
            if channel.topic.endswith("compressedDepth"):
                data = np.frombuffer(bytes(value.data)[12:], np.uint8)
                depths.append(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
            elif channel.topic.endswith("aligned_depth_to_color/camera_info"):
                info = value
    return np.stack(depths), info


def ransac(points, seed):
    """A plane (unit normal towards the origin, distance) through most points within 3 mm."""
    rng, best = np.random.default_rng(seed), (0, None)
    for _ in range(400):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        if np.linalg.norm(normal) < 1e-9:
            continue
        normal /= np.linalg.norm(normal)
        near = np.abs((points - a) @ normal) < 0.003
        if near.sum() > best[0]:
            best = near.sum(), near
    inside = points[best[1]]
    normal = np.linalg.svd(inside - inside.mean(axis=0), full_matrices=False)[2][-1]
    distance = -inside.mean(axis=0) @ normal
    return (normal, distance) if distance > 0 else (-normal, -distance)


def test_a_realsense_recording(tmp_path):
    """Depth exactly; the table as a RANSAC of our own finds it; one object, red where it is red."""
    config = ProcessingConfig(color=colour_range("330-30,40-100"))
    Mcap().convert(MUG, str(tmp_path / "d"), processing=config)
    views = open_dataset(tmp_path / "d").read_depth(0, "recorded")
    depths, info = standard_reader()
    assert np.array_equal(np.rint(views.depth * views.depth_unit * 1e3), depths)
    camera = views.cameras[0]
    assert (camera.intrinsics.fx, camera.intrinsics.cy) == (info.k[0], info.k[5])
    rays = pixel_rays(camera.intrinsics)
    cloud = (rays * depths[0][..., None] / 1e3)[depths[0] > 0][::17]
    normal, distance = ransac(cloud, seed=1)
    assert abs(camera.position[2] - distance) < 0.002
    x, y, z, w = camera.quaternion
    down = 2 * np.array([x * z - y * w, y * z + x * w]), 1 - 2 * (x * x + y * y)
    up = np.append(*down)  # world z in the camera's frame: last row of its rotation
    assert np.degrees(np.arccos(up @ normal)) < 0.5
    found = views.segments[0] >= SEGMENT_COMPONENT
    assert set(np.unique(views.segments[0][found])) == {SEGMENT_COMPONENT}
    assert 2_000 < found.sum() < 20_000
    color = open_dataset(tmp_path / "d").frame(scene=0, frame=0).color()[0].astype(int)
    assert np.mean(color[found][:, 0] > 1.3 * color[found][:, 1:].max(axis=1)) > 0.95


def test_real_dough_through_to_the_tensor(tmp_path):
    """A real ring of dough is one piece, and its heights come through to the model's input."""
    Cloud().convert(RING, str(tmp_path / "d"), processing=ProcessingConfig(expect="doughnut"))
    # Each of 2,009 pixels many times; 83 of the 2,092 points lie behind others.
    sample = DoughDataset(tmp_path / "d", split="real", num_points=2**15)[0]
    assert sample["num_components"] == 1
    heights = np.asarray(o3d.io.read_point_cloud(str(RING)).points)[:, 2]
    heights = heights[heights >= ProcessingConfig().height_min]
    percent = [5, 25, 50, 75, 95]
    expected = np.percentile(heights, percent)
    assert np.percentile(sample["points"][:, 2], percent) == pytest.approx(expected, abs=0.0015)


@pytest.mark.parametrize("kind", ["ply", "pcd", "ascii"])
def test_a_cut_cloud_is_refused(tmp_path, kind):
    """A cloud whose file is whole converts; cut by a few bytes or by half it is refused."""
    path = tmp_path / ("a.ply" if kind == "ply" else "a.pcd")
    cloud = o3d.io.read_point_cloud(str(RING))
    o3d.io.write_point_cloud(str(path), cloud, write_ascii=kind == "ascii")
    assert Cloud().convert(path, str(tmp_path / "d")).frames == 1
    data = path.read_bytes()
    for cut in (60, len(data) // 2):
        path.write_bytes(data[:-cut])
        with pytest.raises(RecordingError):
            Cloud().convert(path, str(tmp_path / "e"))
    assert not (tmp_path / "e").exists()


PCD = (
    "VERSION .7\nFIELDS x y z\nSIZE {0} {0} {0}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {1}\nHEIGHT 1\n"
    "POINTS {1}\nDATA {2}\n"
)


@pytest.mark.parametrize(
    ("head", "body", "reason"),
    [
        ((8, 2, "binary"), bytes(48), "floats of 4 bytes"),
        ((4, 2, "packed"), bytes(24), "'packed'"),
        ((4, 2, "ascii"), b"0 0 0\n1 x 0\n", "point 1 is damaged"),
        ((4, 2, "ascii"), b"0 0 0\n1 0\n", "point 1 is damaged"),
        ((4, 2, "ascii"), b"0 0 0\n", "cut short"),
        ((4, 2, "binary_compressed"), b"\x08\0\0\0\xff\xff\0\0" + bytes(8), "65535 bytes"),
    ],
)
def test_a_pcd_that_open3d_would_misread_is_refused(tmp_path, head, body, reason):
    """Types, encodings and rows that Open3D turns into zeros are refused by name."""
    path = tmp_path / "a.pcd"
    path.write_bytes(PCD.format(*head).encode() + body)
    with pytest.raises(RecordingError, match=reason):
        Cloud().convert(path, str(tmp_path / "d"))


@pytest.mark.parametrize(
    ("scale", "shift", "reason"),
    [(1000, 0.0, "millimetres"), (1, 0.5, "lowest point"), (-1, 0.0, "z must point up")],
)
def test_a_cloud_in_other_units_or_axes_is_refused(tmp_path, scale, shift, reason):
    """Millimetres, a table that is not at 0 and z downwards are refused in one line."""
    cloud = o3d.io.read_point_cloud(str(RING))
    points = np.asarray(cloud.points) * scale + [0, 0, shift]
    moved = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    o3d.io.write_point_cloud(str(tmp_path / "a.ply"), moved)
    with pytest.raises(RecordingError, match=reason):
        Cloud().convert(tmp_path / "a.ply", str(tmp_path / "d"))


def test_points_that_are_none_are_told(tmp_path):
    """Points that are not finite are left out, and how many there were is told."""
    cloud = o3d.io.read_point_cloud(str(RING))
    points = np.asarray(cloud.points).copy()
    points[:7] = np.nan
    bare = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    o3d.io.write_point_cloud(str(tmp_path / "a.pcd"), bare)
    done = Cloud().convert(tmp_path / "a.pcd", str(tmp_path / "d"))
    assert any(line.startswith("7 points are not finite") for line in done.warnings)
