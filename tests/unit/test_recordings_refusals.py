"""What cannot be used is refused by name, and what is odd is told."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from doughdata.dataset import open_dataset
from doughdata.recordings.colour import colour_range
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from tests.recordings_made import (
    COLOR,
    DEPTH,
    INFO,
    LENS,
    Recording,
    rolls_picture,
    write_foxglove,
    write_mcap,
)

PICTURE = rolls_picture()
ROLLS = ProcessingConfig(expect="rolls")


def _encoding(name, encoding, *, first=0):
    """Says that a topic's images, from one on, are encoded in another way."""

    def edit(topic, number, message):
        if topic == name and number >= first:
            message.encoding = encoding
        return message

    return edit


def _lens(**fields):
    def edit(topic, number, message):
        if topic == INFO:
            for name, value in fields.items():
                setattr(
                    message, name, np.array(value, float) if name != "distortion_model" else value
                )
        return message

    return edit


def _millimetres(topic, number, message):
    if topic == DEPTH:
        message.data = (message.data.view(np.float32) * 1000).view(np.uint8)
    return message


class _Unaligned(Recording):
    """The colour camera has another lens."""

    def messages(self, store):
        for topic, kind, at, message in super().messages(store):
            yield topic, kind, at, message
            if topic == INFO:
                other = copy.deepcopy(message)
                other.k = other.k * np.array([1.2, 1, 1, 1, 1.2, 1, 1, 1, 1])
                yield COLOR.replace("image_raw", "camera_info"), kind, at, other


class _Renamed(Recording):
    """Names of topics with a line break and a terminal code."""

    def messages(self, store):
        for topic, *rest in super().messages(store):
            yield topic.replace("/camera/", "/ca\nme\x1b/"), *rest


def _broken_lens(topic, number, message):
    if hasattr(message, "k"):
        message.k[0] = np.nan
    return message


def _without_depth(topic, number, message):
    return None if topic == DEPTH else message


HALF = replace(PICTURE, color=PICTURE.color[::2, ::2])
EMPTY = replace(PICTURE, depth=np.zeros_like(PICTURE.depth))
FLAT = rolls_picture(count=0)
ONE = rolls_picture(count=1)
REFUSED = {
    "no calibration": (Recording(info=False), {}, "--intrinsics"),
    "no depth": (Recording(edit=_without_depth), {}, "no topic with depth"),
    "no valid pixel": (Recording(pictures=[EMPTY] * 2), {}, "no valid depth"),
    "other size": (Recording(pictures=[HALF]), {}, "160 x 120 .* 80 x 60"),
    "other frame": (Recording(frames=("a", "b")), {}, "aligned_depth_to_color"),
    "lens not finite": (Recording(edit=_broken_lens), {}, "not finite"),
    "lens of another size": (Recording(lens=replace(LENS, width=99)), {}, "calibration is for"),
    "bare table": (Recording(pictures=[FLAT]), {}, "nothing stands"),
    "one roll": (Recording(pictures=[ONE]), {"processing": ROLLS}, "found 1"),
    "no such colour": (
        Recording(),
        {"processing": ProcessingConfig(color=colour_range("100-140"))},
        "red and blue",
    ),
    "colour nobody decodes": (Recording(edit=_encoding(COLOR, "nv12")), {}, "'nv12'.*none"),
    "colour without a name": (Recording(edit=_encoding(COLOR, "")), {}, "colour encoding ''"),
    "depth nobody decodes": (Recording(edit=_encoding(DEPTH, "64FC1")), {}, "Image 64fc1"),
    "lens of no camera": (
        Recording(edit=_lens(k=[1e300, 0, 9, 0, 1e300, 9, 0, 0, 1])),
        {},
        "1e.300",
    ),
    "lens of zeros": (Recording(edit=_lens(k=[0.0] * 9)), {}, "not calibrated"),
    "lens of colour differs": (_Unaligned(), {}, "not aligned.*30.*pixels"),
    "lines in a name": (_Renamed(depth="mono16"), {}, "/ca me[?]/"),
    "metres that are millimetres": (
        Recording(depth="32FC1", edit=_millimetres),
        {},
        "--depth-scale",
    ),
    "opening of 7 m": (
        Recording(gripper=True),
        {"topics": TopicOptions(gripper_topic="/joints:elbow")},
        "--gripper-scale",
    ),
    "colour is depth": (Recording(), {"topics": TopicOptions(color_topic=DEPTH)}, "topic of depth"),
    "no such topic": (Recording(), {"topics": TopicOptions(depth_topic="/x")}, "no topic /x"),
    "wrong type": (
        Recording(),
        {"topics": TopicOptions(info_topic=DEPTH)},
        "--info-topic",
    ),
    "mono16": (
        Recording(depth="mono16"),
        {"topics": TopicOptions(depth_topic=DEPTH)},
        "--depth-scale",
    ),
    "no such joint": (
        Recording(gripper=True),
        {"topics": TopicOptions(gripper_topic="/joints:thumb")},
        "thumb",
    ),
    "no tf": (Recording(), {"topics": TopicOptions(tool_frame="tool0")}, "tool0"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_leaves_nothing(tmp_path, name):
    """What cannot be used is refused in one line that says why, and no dataset is left behind."""
    recording, options, reason = REFUSED[name]
    path = write_mcap(tmp_path / "a.mcap", recording)
    with pytest.raises(RecordingError, match=reason) as error:
        Mcap().convert(path, str(tmp_path / "d"), **options)
    assert "\n" not in str(error.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap"]


class _Twice(Recording):
    """Every message twice."""

    def messages(self, store):
        for entry in super().messages(store):
            yield entry
            yield entry


def _far(topic, number, message):
    if topic == DEPTH:
        pixels = message.data.view(np.float32).copy()
        pixels[:40] = 70.0
        message.data = pixels.view(np.uint8)
    return message


def _one_stamp(topic, number, message):
    message.header.stamp.sec = message.header.stamp.nanosec = 5
    if topic == DEPTH:
        message.data[0] ^= number  # another image each
    return message


BENT = [0.1, -0.2, 0.0, 0.0, 0.0]
TOLD = {  # recording -> frames, losses, a line
    "16 bits, then floats": (_encoding(DEPTH, "mono16", first=1), "16UC1", 1, 2, "those before"),
    "copies": (None, "16UC1", 3, 0, "3 images are copies"),
    "one stamp": (_one_stamp, "16UC1", 1, 2, "same time stamp"),
    "too far": (_far, "32FC1", 3, 0, "120 pixels are beyond"),
    "bent": (_lens(d=BENT), "16UC1", 3, 0, "1.0 pixels"),
    "bent, unknown": (_lens(d=BENT, distortion_model="x"), "16UC1", 3, 0, "not known"),
    "bent, overflow": (_lens(d=[1e300] * 5), "16UC1", 3, 0, "not known"),
}


@pytest.mark.parametrize("name", TOLD)
def test_what_is_odd_is_told(tmp_path, name):
    """A recording converts as far as it can, and a warning or a loss says what was odd."""
    edit, depth, frames, lost, line = TOLD[name]
    kind = _Twice if name == "copies" else Recording
    path = write_mcap(tmp_path / "a.mcap", kind(edit=edit, depth=depth))
    done = Mcap().convert(path, str(tmp_path / "d"))
    assert (done.frames, sum(loss.count for loss in done.losses)) == (frames, lost)
    assert line in " ".join((*done.warnings, *map(str, done.losses)))


@pytest.mark.parametrize("scale", [None, 0.001])
def test_a_depth_unit_that_nobody_states_is_told(tmp_path, scale):
    """Foxglove's RawImage states no unit of 16-bit depth: a guess is told, an option is none."""
    path = write_foxglove(tmp_path / "a.mcap", [PICTURE], unit=0.001)
    topics = TopicOptions(depth_scale=scale)
    done = Mcap().convert(path, str(tmp_path / "d"), topics=topics)
    assert any("millimetres were taken" in line for line in done.warnings) == (scale is None)
    views = open_dataset(tmp_path / "d").read_depth(0, "recorded")
    assert np.array_equal(
        np.rint(views.depth[0] * views.depth_unit * 1e3), np.rint(PICTURE.depth * 1e3)
    )


def test_the_scale_of_floats_is_obeyed(tmp_path):
    """Float depth in millimetres comes through within half a unit if the user says what it is."""
    path = write_mcap(tmp_path / "a.mcap", Recording(depth="32FC1", edit=_millimetres))
    Mcap().convert(path, str(tmp_path / "d"), topics=TopicOptions(depth_scale=0.001))
    views = open_dataset(tmp_path / "d").read_depth(0, "recorded")
    assert np.abs(views.depth[0] * views.depth_unit - PICTURE.depth).max() < 0.51e-4
