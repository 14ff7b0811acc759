"""Bags of ROS 1 and ROS 2 give what MCAP gives."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter

from doughdata.dataset import open_dataset
from doughdata.recordings.bag import PARTS, Bag
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.protocol import silent
from doughschemas import DoughError
from tests.recordings_made import ROS1, ROS2, Recording, write_mcap


def write_bag(path, recording):
    """A ROS 1 bag by rosbags."""
    with BagWriter(path) as writer:
        made = {}
        for topic, kind, at, message in recording.messages(ROS1):
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(made[topic], at, ROS1.serialize_ros1(message, kind))
    return path


def write_folder(path, recording, plugin, mode=CompressionMode.NONE):
    """A rosbag2 folder by rosbags."""
    writer = FolderWriter(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        made = {}
        for topic, kind, at, message in recording.messages(ROS2):
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(made[topic], at, ROS2.serialize_cdr(message, kind))
    return path


@pytest.mark.parametrize("kind", ["bag", "sqlite3", "mcap"])
def test_bags_give_what_mcap_gives(tmp_path, kind):
    """A .bag file and rosbag2 folders of both storages give the same images as one MCAP file."""
    recording = Recording(color="bgr8")
    if kind == "bag":
        path = write_bag(tmp_path / "a.bag", recording)
    else:
        path = write_folder(tmp_path / "a", recording, StoragePlugin[kind.upper()])
    assert Bag().takes(path)
    assert not Mcap().takes(path)
    whole = write_mcap(tmp_path / "a.mcap", recording)
    Bag().convert(path, str(tmp_path / "b"))
    Mcap().convert(whole, str(tmp_path / "m"))
    bag, plain = open_dataset(tmp_path / "b"), open_dataset(tmp_path / "m")
    for frame in range(3):
        a, b = bag.frame(scene=0, frame=frame), plain.frame(scene=0, frame=frame)
        assert np.array_equal(a.color(), b.color())
        assert np.array_equal(a.depth("recorded").depth, b.depth("recorded").depth)


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_a_cut_bag_is_refused(tmp_path, share):
    """A bag that was cut short is refused in one line, and nothing is left behind."""
    path = write_bag(tmp_path / "a.bag", Recording())
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(DoughError) as error:
        Bag().convert(path, str(tmp_path / "d"))
    assert "\n" not in str(error.value)
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_compressed_folders_are_read(tmp_path, plugin, mode):
    """Folders that rosbag2 compressed, whole files or each message, lose nothing."""
    source = Bag().open(write_folder(tmp_path / "a", Recording(), plugin, mode), silent)
    assert (source.num_messages, source.num_expected, source.losses) == (9, 9, ())
    assert not any(message.error for message in source.messages(source.topics))


def _more(path, name):
    """Let the description name one more file."""
    text = (path / "metadata.yaml").read_text()
    file = next(p for p in path.iterdir() if p.suffix != ".yaml")
    (path / "metadata.yaml").write_text(
        text.replace(f"- {file.name}", f"- {file.name}\n  - {name}")
    )


def _empty(path):
    _more(path, f"more{PARTS[0]}")
    (path / f"more{PARTS[0]}").write_bytes(b"")


def _count(path):
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("message_count: 9", "message_count: 11"))


SPOILT = {
    "a file is missing": (lambda path: _more(path, "more.mcap"), "missing: more.mcap"),
    "an empty file": (_empty, "bag"),
    "a count": (_count, "says 11 messages, the files hold 9"),
    "rubbish": (lambda path: (path / "metadata.yaml").write_bytes(b"\xff :"), "is damaged"),
    "a list": (lambda path: (path / "metadata.yaml").write_text("[1]"), "is damaged"),
}


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("name", SPOILT)
def test_a_folder_that_lacks_something_is_told(tmp_path, plugin, name):
    """What a folder's description promises and the folder lacks is a loss; the rest is read."""
    spoil, reason = SPOILT[name]
    path = write_folder(tmp_path / "a", Recording(), plugin)
    spoil(path)
    source = Bag().open(path, silent)
    assert reason in " ".join(map(str, source.losses))
    assert len(list(source.messages(source.topics))) == 9


def test_a_folder_whose_recorder_was_killed(tmp_path):
    """Without a description the files are read, and it is told that some may be missing."""
    path = write_folder(tmp_path / "a", Recording(), StoragePlugin.SQLITE3)
    (path / "metadata.yaml").unlink()
    source = Bag().open(path, silent)
    assert (source.num_messages, source.losses) == (9, ())
    assert any("metadata.yaml" in line for line in source.warnings)
