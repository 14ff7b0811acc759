"""Whole recordings of a scene known in closed form become scenes of a dataset."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doughdata.dataset import open_dataset, validate
from doughdata.geometry import quaternion_to_matrix
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.render.cameras import look_at
from doughdata.torch import DoughDataset
from doughschemas import SEGMENT_COMPONENT, SEGMENT_TABLE, DatasetError, DoughError
from tests.closed_form import cut_ring
from tests.dataset_helpers import new_writer, write_examples
from tests.recordings_damage import chunk_spans, corrupted
from tests.recordings_made import (
    CAMERA,
    LENS,
    RADIUS,
    Recording,
    rolls_picture,
    write_foxglove,
    write_mcap,
)

PICTURE = rolls_picture()
ONE = rolls_picture(count=1)
ROLLS = ProcessingConfig(expect="rolls")


def convert(path, dataset, **options):
    """Convert and open the dataset."""
    done = Mcap().convert(path, str(dataset), **options)
    return done, open_dataset(dataset)


def units(opened, scene=0):
    """Depth of a recording in whole 0.1 mm."""
    views = opened.read_depth(scene, "recorded")
    return np.rint(views.depth * views.depth_unit * 1e4).astype(int)


@pytest.mark.parametrize(
    "recording",
    [
        Recording(),
        Recording(color="bgr8", padding=4),
        Recording(color="rgba8", depth="32FC1"),
        Recording(color="mono8", depth="png"),
        Recording(color="jpeg", depth="rvl"),
        Recording(color="png", big_endian=False, padding=1),
        Recording(color=None, big_endian=True),
    ],
    ids=lambda r: f"{r.depth}-{r.color}",
)
@pytest.mark.parametrize("ros", [1, 2])
def test_every_encoding_gives_the_depth_that_was_recorded(tmp_path, recording, ros):
    """Millimetres come through exactly, float metres within half a unit; the dataset is valid."""
    path = write_mcap(tmp_path / "a.mcap", recording, ros=ros)
    done, opened = convert(path, tmp_path / "d")
    assert (done.frames, done.losses) == (3, ())
    expected = np.rint(PICTURE.depth * 1e4)
    if recording.depth != "32FC1":
        expected = np.rint(PICTURE.depth * 1e3) * 10
    assert np.array_equal(units(opened), np.stack([expected.astype(int)] * 3))
    color = opened.frame(scene=0, frame=2).color()
    assert (color is None) == (recording.color is None)
    if recording.color in ("rgb8", "bgr8", "rgba8", "png"):
        assert np.array_equal(color[0], PICTURE.color)
    assert validate(tmp_path / "d", deep=True).ok


def test_foxglove_protobuf(tmp_path):
    """Foxglove's own types, written by their package, give the same depth and colour."""
    _, opened = convert(write_foxglove(tmp_path / "a.mcap", [PICTURE] * 2), tmp_path / "d")
    assert np.array_equal(units(opened)[1], np.rint(PICTURE.depth * 1e4).astype(int))
    assert np.array_equal(opened.frame(scene=0, frame=0).color()[0], PICTURE.color)


@pytest.mark.parametrize("turn", [0.0, 0.4, -1.1, 1.5])
def test_rolls_lie_side_by_side_along_x(tmp_path, turn):
    """Two rolls end up along y, the median axis between them at x = 0, whatever their yaw was.

    The camera's pose in that world is the true one: height within 2 mm, tilt within 0.5 degrees.
    """
    picture = rolls_picture(turn=turn)
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[picture]))
    _, opened = convert(path, tmp_path / "d", processing=ROLLS)
    views = opened.read_depth(0, "recorded")
    camera = views.cameras[0]
    assert abs(camera.position[2] - CAMERA.position[2]) < 0.002
    found, true = (quaternion_to_matrix(np.array(c.quaternion))[2, 2] for c in (camera, CAMERA))
    assert abs(np.degrees(np.arccos(-found) - np.arccos(-true))) < 0.5
    for seen, side in ((16, -1), (17, 1)):
        points = world_points(views, views.segments[0] == seen)
        assert abs(points[:, 0].mean() - side * 0.018) < 0.003
        spread = points[:, :2].std(axis=0)
        assert spread[1] > 2 * spread[0]
        assert points[:, 2].max() == pytest.approx(2 * RADIUS, abs=0.002)


def world_points(views, mask):
    """Points [m] of some pixels of the first view, worked out by hand."""
    k, camera = views.cameras[0].intrinsics, views.cameras[0]
    v, u = np.nonzero(mask)
    z = views.depth[0][mask] * views.depth_unit
    local = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z], axis=1)
    return local @ quaternion_to_matrix(np.array(camera.quaternion)).T + camera.position


def test_segments_are_what_is_there(tmp_path):
    """Pixels named as table or dough are that, and most of the dough is named."""
    _, opened = convert(write_mcap(tmp_path / "a.mcap"), tmp_path / "d", processing=ROLLS)
    segments = opened.read_depth(0, "recorded").segments[0]
    heights = 0.004  # a roll's foot lies within the plane's tolerance
    assert np.all(PICTURE.roll[segments >= SEGMENT_COMPONENT] >= 0)
    assert np.mean(PICTURE.roll[segments == SEGMENT_TABLE] < 0) > 1 - heights * 10
    assert np.mean(segments[PICTURE.roll >= 0] >= SEGMENT_COMPONENT) > 0.7


def test_two_cameras_must_be_told_apart(tmp_path):
    """Two depth topics without a word about which are refused, naming both; a name is obeyed."""
    both = _Both(pictures=[PICTURE])
    path = write_mcap(tmp_path / "a.mcap", both)
    with pytest.raises(RecordingError, match="/b/depth"):
        Mcap().convert(path, str(tmp_path / "d"))
    topics = TopicOptions(depth_topic="/b/depth", color_topic="none", info_topic="/b/camera_info")
    done, opened = convert(path, tmp_path / "d", topics=topics)
    assert done.frames == 1
    assert opened.frame(scene=0, frame=0).color() is None


class _Both(Recording):
    """The same camera twice, under other names."""

    def messages(self, store):
        for topic, kind, at, message in super().messages(store):
            for camera in ("a", "b"):
                short = {"CameraInfo": "camera_info"}.get(kind.rpartition("/")[2], "depth")
                if not topic.startswith("/camera/color"):
                    yield f"/{camera}/{short}", kind, at, message


def test_a_damaged_image_is_told_and_the_others_convert(tmp_path):
    """Of three frames the one whose PNG is cut is counted as lost; two are in the dataset."""

    def cut(topic, number, message):
        if number == 1 and topic.endswith("compressedDepth"):
            message.data = message.data[:-40]
        return message

    path = write_mcap(tmp_path / "a.mcap", Recording(depth="png", edit=cut))
    done, opened = convert(path, tmp_path / "d")
    (loss,) = done.losses
    assert (done.frames, loss.count, loss.unit) == (2, 1, "image")
    told = json.loads(opened.scenes["parameters"][0].as_py())["losses"]
    assert told[0]["count"] == 1
    assert np.allclose(np.diff(opened.frames["timestamp"].to_numpy()), 2 / 30, atol=1e-4)


def test_salvage_takes_what_is_left(tmp_path):
    """A recording with a bad chunk is refused; with salvage the rest comes and the loss is kept."""
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[PICTURE] * 6), chunk_size=5000)
    data = bytearray(path.read_bytes())
    start, end = chunk_spans(bytes(data), path)[3]
    data[(start + end) // 2] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(RecordingError, match="--salvage"):
        Mcap().convert(path, str(tmp_path / "d"))
    assert not (tmp_path / "d").exists()
    done, opened = convert(path, tmp_path / "d", salvage=True)
    assert 0 < done.frames < 6
    losses = json.loads(opened.scenes["parameters"][0].as_py())["losses"]
    assert sum(loss["count"] for loss in losses if loss["unit"] == "message") > 0
    assert validate(tmp_path / "d", deep=True).ok


def test_the_same_again_changes_nothing(tmp_path):
    """A recording that is in the dataset is not converted twice; another one becomes scene 1."""
    first = write_mcap(tmp_path / "a.mcap")
    _, opened = convert(first, tmp_path / "d")
    before = opened.fingerprint
    done, opened = convert(first, tmp_path / "d")
    assert (done.scenes, opened.fingerprint) == ((0,), before)
    (tmp_path / "x").mkdir()
    other = write_mcap(tmp_path / "x" / "a.mcap", Recording(pictures=[ONE] * 2))
    done, opened = convert(other, tmp_path / "d")
    assert (done.scenes, opened.scene_indices) == ((1,), [0, 1])
    assert len(set(opened.scenes["scene_id"].to_pylist())) == 2
    assert validate(tmp_path / "d", deep=True).ok


def test_beside_simulated_scenes(tmp_path):
    """A recording joins a dataset of simulated scenes; a longer one is thinned evenly and told."""
    writer = write_examples(new_writer(tmp_path / "d"))
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[PICTURE] * (2 * writer.num_frames)))
    done, opened = convert(path, tmp_path / "d")
    assert done.frames == writer.num_frames
    assert any("evenly" in warning for warning in done.warnings)
    assert opened.info["splits"]["real"] == {"scenes": 1, "frames": writer.num_frames}
    assert opened.frame(scene=0, frame=0).particles.positions.shape == (
        cut_ring().particles.positions[0].shape
    )
    report = validate(tmp_path / "d", deep=True)
    assert report.ok, report.problems


def test_samples_have_the_simulated_ones_shape(tmp_path):
    """Real observations come in the tensors of simulated ones; what nobody knows is -1."""
    write_examples(new_writer(tmp_path / "s"))
    convert(write_mcap(tmp_path / "a.mcap"), tmp_path / "d", processing=ROLLS)
    simulated = DoughDataset(tmp_path / "s", sensor="none")[0]
    real = DoughDataset(tmp_path / "d", split="real")[0]
    shapes = {name: (value.shape, value.dtype) for name, value in simulated.items()}
    assert {name: (value.shape, value.dtype) for name, value in real.items()} == shapes
    assert real["num_components"] == 2
    assert set(real["point_labels"].tolist()) == {0, 1}
    assert set(real["query_labels"].tolist()) == set(real["genus"].tolist()) == {-1}
    assert 0.004 < real["points"][:, 2].min() < real["points"][:, 2].max() < 2 * RADIUS + 0.002


def test_far_pixels_need_a_coarser_unit(tmp_path):
    """Millimetres beyond 6.5 m come through exactly, also if they first appear in a later frame."""
    far = replace(PICTURE, depth=PICTURE.depth.copy())
    far.depth[0, 0] = 60.123
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[PICTURE, far]))
    _, opened = convert(path, tmp_path / "d")
    views = opened.read_depth(0, "recorded")
    assert views.depth_unit == 1e-3
    assert np.array_equal(views.depth[1], np.rint(far.depth * 1e3).astype(np.uint16))


def test_opening_by_joint_name(tmp_path):
    """The opening is taken by the joint's name and interpolated between the samples."""
    path = write_mcap(tmp_path / "a.mcap", Recording(gripper=True))
    topics = TopicOptions(gripper_topic="/joints:width")
    _, opened = convert(path, tmp_path / "d", topics=topics)
    between = 0.0073 / (1 / 30) * 0.01  # depth is taken so much later than the joints
    expected = [0.05 - between, 0.04 - between, 0.03]
    assert np.allclose(opened.frames["opening"].to_numpy(), expected, atol=1e-5)


def test_without_stamps_the_time_of_logging_counts(tmp_path):
    """Images whose stamps are 0 are paired by the time they were logged, with a warning."""
    done, _ = convert(write_mcap(tmp_path / "a.mcap", Recording(stamped=False)), tmp_path / "d")
    assert done.frames == 3
    assert any("without time stamps" in warning for warning in done.warnings)


def test_a_camera_that_moves_is_told(tmp_path):
    """If the table is somewhere else in a later frame, a warning says by how much."""
    moved = rolls_picture(look_at(LENS, (0.03, 0.33, 0.35), (0.0, 0.0, 0.03)))
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[PICTURE, moved]))
    done, _ = convert(path, tmp_path / "d")
    assert any("camera moved" in warning for warning in done.warnings)


@pytest.mark.parametrize(("options", "frames"), [({"every": 2}, 3), ({"frames": 2}, 2), ({}, 5)])
def test_fewer_frames_on_request(tmp_path, options, frames):
    """Every n-th, or so many, both ends included."""
    path = write_mcap(tmp_path / "a.mcap", Recording(pictures=[PICTURE] * 5))
    done, opened = convert(path, tmp_path / "d", topics=TopicOptions(**options))
    assert done.frames == frames
    times = opened.frames["timestamp"].to_numpy()
    assert times[-1] == pytest.approx(4 / 30, abs=1e-6)


def test_a_folder_with_something_else_is_not_touched(tmp_path):
    """A folder that is no dataset is refused before anything is written."""
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "thesis.txt").write_text("mine")
    with pytest.raises(DatasetError, match=r"thesis\.txt"):
        Mcap().convert(write_mcap(tmp_path / "a.mcap"), str(tmp_path / "d"))
    assert [p.name for p in (tmp_path / "d").iterdir()] == ["thesis.txt"]


def check_conversions(tmp_path, *, count, first):
    """Convert damaged files: told, refused or whole, and no dataset where it was refused."""
    path = write_mcap(tmp_path / "a.mcap", chunk_size=20_000)
    data, bad = path.read_bytes(), tmp_path / "b.mcap"
    spans = chunk_spans(data, path)
    for seed in range(first, first + count):
        bad.write_bytes(corrupted(data, spans, np.random.default_rng(seed)))
        dataset = tmp_path / f"d{seed}"
        try:
            done = Mcap().convert(bad, str(dataset), salvage=bool(seed % 2))
        except DoughError as error:
            message = str(error)
        else:
            message = ""
        assert (bool(message), "\n" in message) == (not dataset.exists(), False), seed
        if not message and not done.losses:
            assert np.array_equal(units(open_dataset(dataset)), WHOLE), seed


WHOLE = np.stack([np.rint(PICTURE.depth * 1e3).astype(int) * 10] * 3)


def test_no_damage_converts_in_silence(tmp_path):
    """Of 60 random damages each conversion is exact, told, or refused without a trace."""
    check_conversions(tmp_path, count=60, first=0)


@pytest.mark.slow
def test_no_damage_converts_in_silence_2000(tmp_path):
    """The same with 2,000."""
    check_conversions(tmp_path, count=2000, first=60)
