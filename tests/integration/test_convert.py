"""`doughdata convert` and `export --to mcap` as a user types them."""

import json

import numpy as np
import open3d as o3d
import pytest

from doughdata import open_dataset
from doughdata.geometry import quaternion_to_matrix
from doughdata.torch import DoughDataset
from doughschemas import SEGMENT_COMPONENT
from tests.integration.conftest import command
from tests.recordings_made import LENS, Recording, rolls_picture, write_mcap


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Three frames of two rolls."""
    return write_mcap(tmp_path_factory.mktemp("rec") / "run.mcap", Recording(gripper=True))


@pytest.fixture(scope="module")
def converted(recording):
    """The dataset made of it, with every kind of option."""
    options = ("--expect", "rolls", "--color", "340-20", "--gripper-topic", "/joints:width")
    done = command(
        "convert",
        recording,
        "--dataset",
        "d",
        *options,
        "--save-steps",
        "steps",
        "--json",
        cwd=recording.parent,
    )
    return recording.parent / "d", json.loads(done.stdout)


def test_a_recording_becomes_a_dataset_for_every_command(converted):
    """validate --deep, info, stats and view work on it; the steps are drawn; JSON tells figures."""
    dataset, told = converted
    folder = dataset.parent
    assert (told["frames"], told["losses"], told["scenes"]) == (3, [], [0])
    assert told["figures"]["pieces_first"] == 2
    assert (folder / "steps" / "steps.png").stat().st_size > 10_000
    for arguments in (("validate", "--deep"), ("info",), ("stats",), ("view", "--save", "x.png")):
        command(*arguments, "--dataset", "d", cwd=folder)
    assert (folder / "x.png").stat().st_size > 10_000
    info = json.loads(command("info", "--json", "--dataset", "d", cwd=folder).stdout)
    assert info["families"] == {"recording/real": 1}
    line = command("view", "--save", "x.html", "--dataset", "d", cwd=folder, code=None).stderr
    assert "is a recording" in line


def test_export_to_mcap_and_back(converted):
    """A recording exported to MCAP and converted again is the same: depth, colour, opening."""
    dataset, _ = converted
    folder = dataset.parent
    command("export", "--to", "mcap", "--out", "back.mcap", "--dataset", "d", cwd=folder)
    command("convert", "back.mcap", "--dataset", "e", "--expect", "rolls", cwd=folder)
    first, second = open_dataset(dataset), open_dataset(folder / "e")
    a, b = first.read_depth(0, "recorded"), second.read_depth(0, "recorded")
    assert np.array_equal(a.depth * a.depth_unit, b.depth * b.depth_unit)
    assert np.allclose(
        first.frames["timestamp"].to_numpy(), second.frames["timestamp"].to_numpy(), atol=1e-8
    )
    for frame in range(3):
        assert np.array_equal(
            first.frame(scene=0, frame=frame).color(), second.frame(scene=0, frame=frame).color()
        )


def test_a_simulated_scene_exported_and_converted_again(tiny_dataset, tmp_path):
    """Depth comes back unit for unit, the camera's height within 2 mm, its tilt within 0.5 degrees.

    The dough that is found is dough, and most of what stands above the height band's lower edge
    is found.
    """
    command(
        "export",
        "--to",
        "mcap",
        "--scene",
        2,
        "--option",
        "sensor=none",
        "--out",
        tmp_path / "ring.mcap",
        "--dataset",
        tiny_dataset,
        cwd=tmp_path,
    )
    command(
        "convert",
        "ring.mcap",
        "--dataset",
        "d",
        "--depth-topic",
        "/camera/depth",
        "--height-max",
        0.03,
        cwd=tmp_path,
    )
    simulated = open_dataset(tiny_dataset).read_depth(2, "none")
    real = open_dataset(tmp_path / "d").read_depth(0, "recorded")
    assert real.depth_unit == simulated.depth_unit
    assert np.array_equal(real.depth, simulated.depth)
    cameras = simulated.cameras[0], real.cameras[0]
    heights = [camera.position[2] for camera in cameras]
    tilts = [
        np.degrees(np.arccos(-quaternion_to_matrix(np.array(c.quaternion))[2, 2])) for c in cameras
    ]
    assert abs(np.subtract(*heights)) < 0.002
    assert abs(np.subtract(*tilts)) < 0.5
    dough, found = (v.segments >= SEGMENT_COMPONENT for v in (simulated, real))
    assert np.mean(simulated.segments[found] > 1) > 0.99  # dough, or a finger beside it
    assert np.mean(found[dough]) > 0.6


def test_foxglove_topics_are_what_foxglove_reads(tiny_dataset, tmp_path):
    """The file holds Foxglove's types under their names, for every key frame."""
    from mcap.reader import make_reader

    out = tmp_path / "a.mcap"
    command(
        "export",
        "--to",
        "mcap",
        "--scene",
        0,
        "--out",
        out,
        "--dataset",
        tiny_dataset,
        cwd=tmp_path,
    )
    with out.open("rb") as file:
        found = {c.topic: s.name for s, c, _ in make_reader(file).iter_messages()}
    assert found["/dough/points"] == "foxglove.PointCloud"
    assert found["/dough/meshes"] == found["/gripper/meshes"] == "foxglove.SceneUpdate"
    assert found["/tf"] == "foxglove.FrameTransforms"
    assert found["/camera/calibration"] == "foxglove.CameraCalibration"
    assert found["/camera/depth"] == "foxglove.RawImage"


def test_a_cloud_keeps_its_heights(tmp_path):
    """A dome of known height in a PLY file: one piece, its height profile kept through the loader.

    The oracle is the dome itself: z = H (1 - r2 / R2) above the table.
    """
    rng = np.random.default_rng(0)
    height, radius, middle = 0.03, 0.04, np.array([0.43, -0.07])
    r, angle = radius * np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    xy = middle + np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)
    points = np.column_stack([xy, height * (1 - (r / radius) ** 2)])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    o3d.io.write_point_cloud(str(tmp_path / "dome.ply"), cloud)
    command("convert", "dome.ply", "--dataset", "d", "--expect", "ball", cwd=tmp_path)
    sample = DoughDataset(tmp_path / "d", split="real", num_points=2000)[0]
    x, y, z = sample["points"].numpy().T
    assert sample["num_components"] == 1
    profile = height * (1 - (x**2 + y**2) / radius**2)
    assert np.percentile(np.abs(z - profile), 95) < 0.002
    assert z.max() == pytest.approx(height, abs=0.0015)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.txt", b"hello", "nothing that a converter takes"),
        ("a.mcap", b"hello", "no MCAP file"),
        ("empty.mcap", b"", "empty"),
        ("a.mcap.zst", b"\x28\xb5\x2f\xfd1234", "zstd -d"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "a.ply: "),
        ("a.bag", b"#ROSBAG V2.0\nrubbish", "bag"),
        ("missing.mcap", None, "no such file"),
        ("folder", "folder", "nothing that a converter takes"),
    ],
)
def test_what_is_no_recording(tmp_path, name, data, reason):
    """A text, an empty file, a compressed file, a folder: exit code 1, one line, no dataset."""
    if data == "folder":
        (tmp_path / name).mkdir()
    elif data is not None:
        (tmp_path / name).write_bytes(data)
    done = command("convert", name, "--dataset", "d", cwd=tmp_path, code=1)
    lines = [line for line in done.stderr.splitlines() if line.startswith("doughdata:")]
    assert len(lines) == 1
    assert reason in lines[0]
    assert not (tmp_path / "d").exists()


def test_loss_decides_the_exit_code(tmp_path):
    """One bad image: exit code 1 and it is told; with --salvage 0; the rest is there both times."""

    def cut(topic, number, message):
        if number == 2 and "depth" in topic and "info" not in topic:
            message.data = message.data[:-40]
        return message

    write_mcap(tmp_path / "a.mcap", Recording(depth="png", edit=cut))
    for code, options in ((1, ()), (0, ("--salvage",)), (1, ())):
        done = command(
            "convert", "a.mcap", "--dataset", "d", "--json", *options, cwd=tmp_path, code=code
        )
        told = json.loads(done.stdout)
        assert (told["frames"], told["losses"][0]["count"]) == (2, 1)


def test_intrinsics_from_a_file(tmp_path):
    """A recording without calibration converts with a file of intrinsics."""
    write_mcap(tmp_path / "a.mcap", Recording(info=False, pictures=[rolls_picture()]))
    fields = {name: getattr(LENS, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (tmp_path / "lens.json").write_text(json.dumps(fields))
    command("convert", "a.mcap", "--dataset", "d", cwd=tmp_path, code=1)
    command("convert", "a.mcap", "--dataset", "d", "--intrinsics", "lens.json", cwd=tmp_path)


@pytest.mark.parametrize(
    "options", [("--color", "red"), ("--option", "sizes=3"), ("--expect", "x")]
)
def test_bad_usage(recording, tmp_path, options):
    """Options that cannot be meant are bad usage, exit code 2."""
    command("convert", recording, "--dataset", "d", *options, cwd=tmp_path, code=2)
