"""The LeRobot export: the layout of its format v3.0, read back as its loader does.

The loader's steps (huggingface/lerobot, `load_info`, `load_tasks`, `load_episodes`,
`get_hf_features_from_features`, `Dataset.from_parquet`) are done here with pandas and `datasets`.
The slow test runs the loader itself; with all that it depends on it would bring gigabytes.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from doughdata.dataset import open_dataset
from doughdata.dataset.split import SplitPlan, resplit
from doughdata.exporters.lerobot import LeRobot
from doughschemas import BadInputError, MissingLayerError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
INFO = {  # keys that LeRobot 0.4 reads
    *("codebase_version", "robot_type", "total_episodes", "total_frames", "total_tasks"),
    *("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb", "fps", "splits"),
    *("data_path", "video_path", "features"),
}
LEROBOT = ("lerobot==0.4.4", "accelerate==1.15.0", "av==18.1.0", "torchvision==0.28.0")
LOAD = """
import json, sys, torch
# torchvision of PyPI has its operators compiled for CUDA; two must be known for its import.
library = torch.library.Library("torchvision", "DEF")
for name in ("nms", "qnms"):
    library.define(name + "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("local/dough", root=sys.argv[1])
rows = [row for batch in torch.utils.data.DataLoader(dataset, batch_size=2)
        for row in zip(*(batch[name].tolist() for name in json.loads(sys.argv[2])))]
print(json.dumps([dataset.num_episodes, dataset.fps, rows]))
"""
INDEX = ("timestamp", "frame_index", "episode_index", "index", "task_index")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bars (train) and the ring (test), exact depth included."""
    folder = tmp_path_factory.mktemp("lerobot")
    write_examples(new_writer(folder / "one"))
    resplit(folder / "one", folder / "d", SplitPlan(test=0.5))
    LeRobot().export(open_dataset(folder / "d"), [0, 1], folder / "out", exact=True)
    return folder / "out"


def info_of(folder: Path) -> dict:
    return json.loads((folder / "meta/info.json").read_text())


def frames_of(folder: Path):
    """The frames as LeRobot's loader opens them: by the features of info.json."""
    import datasets

    datasets.disable_progress_bars()
    features = {}
    for name, feature in info_of(folder)["features"].items():
        dtype, shape = feature["dtype"], feature["shape"]
        if dtype == "image":
            features[name] = datasets.Image()
        elif shape == [1]:
            features[name] = datasets.Value(dtype)
        elif len(shape) == 1:
            features[name] = datasets.Sequence(datasets.Value(dtype), length=shape[0])
        else:
            features[name] = datasets.Array2D(shape=tuple(shape), dtype=dtype)
    paths = sorted(map(str, (folder / "data").glob("*/*.parquet")))
    cache = str(folder.parent / "cache")
    return datasets.Dataset.from_parquet(
        paths, features=datasets.Features(features), cache_dir=cache
    )


def test_info_says_what_there_is(exported: Path) -> None:
    """info.json has every key that the loader reads, and its totals and splits are right."""
    info = info_of(exported)
    assert set(info) == INFO
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"]) == (2, 2 * NUM_FRAMES)
    assert info["splits"] == {"train": "0:1", "test": "1:2"}
    assert isinstance(info["fps"], int)
    assert set(INDEX) <= set(info["features"])


def test_episodes_are_where_they_say(exported: Path) -> None:
    """meta/episodes gives each episode's frames in the data file that it names; frames of an
    episode follow each other by 1 / fps."""
    info, frames = info_of(exported), frames_of(exported)
    episodes = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["dataset_from_index"].tolist() == [0, NUM_FRAMES]
    assert episodes["dataset_to_index"].tolist() == [NUM_FRAMES, 2 * NUM_FRAMES]
    for _, episode in episodes.iterrows():
        path = info["data_path"].format(
            chunk_index=episode["data/chunk_index"], file_index=episode["data/file_index"]
        )
        assert (exported / path).is_file()
        part = frames[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert set(part["episode_index"]) == {episode["episode_index"]}
        assert part["frame_index"] == list(range(episode["length"]))
        steps = np.diff(part["timestamp"]) * info["fps"]
        np.testing.assert_allclose(steps, 1.0, atol=1e-4)
    assert frames["index"][:] == list(range(2 * NUM_FRAMES))


def test_frames_hold_the_records(exported: Path) -> None:
    """State, next state as action, genus, exact depth and the 8-bit image are those of the
    records; the true time stands beside the nominal one."""
    frames, features = frames_of(exported), info_of(exported)["features"]
    near, far = (features["observation.images.none"]["info"][k] for k in ("near", "far"))
    order = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")["scene_index"]
    for number, scene in enumerate(order):
        example = (RING, BARS)[scene]
        poses = example.particles.tool_poses
        for k in range(NUM_FRAMES):
            row = frames[number * NUM_FRAMES + k]
            assert row["observation.state"][0] == pytest.approx(poses.opening[k])
            after = min(k + 1, NUM_FRAMES - 1)
            assert row["action"][1:4] == pytest.approx(poses.position[after, 0].tolist())
            genus = example.topology.frames[k].genus
            assert row["observation.num_components"] == len(genus)
            assert row["observation.genus"] == [*genus, *[-1] * (8 - len(genus))]
            time = example.particles.timestamps[k]
            assert row["observation.time"] == pytest.approx(time)
            depth = np.array(row["observation.depth.none"])
            assert np.array_equal(depth, example.depth.depth[k])
            grey = np.array(row["observation.images.none"])
            assert grey.shape == (*depth.shape, 3)
            expected = (depth * 1e-4 - near) / (far - near) * 255
            np.testing.assert_allclose(grey[..., 0], expected, atol=0.5001)


@pytest.mark.slow
def test_the_loader_itself_opens_it(exported: Path, tmp_path: Path) -> None:
    """LeRobotDataset and a DataLoader give every frame with the values that were written."""
    pip = [sys.executable, "-m", "pip", "install", "-qq", "--no-deps", "--target", tmp_path / "lib"]
    subprocess.run([*pip, *LEROBOT], check=True)
    names = ("observation.state", "action", "observation.genus", "episode_index", "frame_index")
    done = subprocess.run(
        [sys.executable, "-c", LOAD, exported, json.dumps(names)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "lib"), "HF_HUB_OFFLINE": "1"},
    )
    episodes, fps, rows = json.loads(done.stdout)
    assert (episodes, fps) == (2, info_of(exported)["fps"])
    frames = frames_of(exported)
    assert len(rows) == len(frames)
    for row, frame in zip(rows, frames, strict=True):
        for name, value in zip(names, row, strict=True):
            np.testing.assert_allclose(value, frame[name], rtol=1e-6)


def test_tasks_are_indexed_by_their_text(exported: Path) -> None:
    """pandas gives the table that LeRobot expects: the task as index, its number as column."""
    tasks = pd.read_parquet(exported / "meta/tasks.parquet")
    assert tasks.index.tolist() == ["squeeze custom"]
    assert tasks["task_index"].tolist() == [0]


def test_statistics_are_those_of_the_frames(exported: Path) -> None:
    """meta/stats.json and the episodes' own statistics are what numpy counts in the frames; those
    of images are (3, 1, 1) and lie within 0..1."""
    stats, frames = json.loads((exported / "meta/stats.json").read_text()), frames_of(exported)
    for name in ("observation.state", "action"):
        values = np.array(frames[name][:])
        np.testing.assert_allclose(stats[name]["mean"], values.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(stats[name]["std"], values.std(axis=0), atol=1e-6)
        assert stats[name]["count"] == [len(frames)]
    images = np.stack([np.array(i) for i in frames["observation.images.none"]]) / 255
    image = stats["observation.images.none"]
    assert np.shape(image["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(np.ravel(image["mean"]), images.mean(axis=(0, 1, 2)), atol=1e-9)
    episodes = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")
    first = np.array(frames["observation.state"][:NUM_FRAMES])
    np.testing.assert_allclose(
        episodes["stats/observation.state/max"][0], first.max(axis=0), atol=1e-7
    )


def test_bad_requests_leave_nothing(tmp_path: Path) -> None:
    """Without topology, or with a range of depth that is none, one line says what to do."""
    write_examples(new_writer(tmp_path / "d"), [RING], layers=("sim",))
    opened = open_dataset(tmp_path / "d")
    with pytest.raises(MissingLayerError, match="--stages topology"):
        LeRobot().export(opened, [0], tmp_path / "out")
    with pytest.raises(BadInputError, match="near < far"):
        LeRobot().export(opened, [0], tmp_path / "out", near=1.0, far=0.5)
    assert [path.name for path in tmp_path.iterdir()] == ["d"]
