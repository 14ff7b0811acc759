"""Bags of ROS 1 and ROS 2 give what MCAP gives."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter

from doughdata.dataset import open_dataset
from doughdata.recordings.bag import Bag
from doughdata.recordings.mcap import Mcap
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


def write_folder(path, recording, plugin):
    """A rosbag2 folder by rosbags."""
    with FolderWriter(path, version=9, storage_plugin=plugin) as writer:
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
