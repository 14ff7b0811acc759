"""The Hugging Face export, read back by `datasets`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doughdata.dataset import open_dataset
from doughdata.dataset.split import SplitPlan, resplit
from doughdata.exporters.hf import HuggingFace
from doughschemas import BadInputError, MissingLayerError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ring in `test`, the bars in `train`, with all layers."""
    folder = tmp_path_factory.mktemp("hf")
    write_examples(new_writer(folder / "one"))
    resplit(folder / "one", folder / "d", SplitPlan(test=0.5))
    return folder / "d"


def load(folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch):
    """What `load_dataset` makes of a folder, without a network."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    import datasets

    datasets.disable_progress_bars()
    return datasets.load_dataset(str(folder), cache_dir=str(cache))


def test_every_key_frame_comes_back(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Splits, particles, labels, genus, poses, depth and segments are those of the records, to the
    last bit where the format keeps it."""
    opened = open_dataset(dataset)
    HuggingFace().export(opened, [0, 1], tmp_path / "out")
    loaded = load(tmp_path / "out", tmp_path / "cache", monkeypatch)
    splits = opened.scenes["split"].to_pylist()
    assert {name: len(rows) for name, rows in loaded.items()} == dict.fromkeys(splits, NUM_FRAMES)
    for index, example in enumerate((RING, BARS)):
        for k, row in enumerate(loaded[splits[index]]):
            assert (row["scene_id"], row["frame_index"]) == (example.scene.scene_id, k)
            positions = np.array(row["positions"], np.float32)
            assert np.array_equal(positions, example.particles.positions[k])
            topology = example.topology.frames[k]
            assert row["labels"] == topology.labels.tolist()
            assert tuple(row["genus"]) == topology.genus
            assert np.array_equal(np.array(row["depth_none"]), example.depth.depth[k])
            assert np.array_equal(np.array(row["segments_none"]), example.depth.segments[k])
            assert row["depth_unit_none"] == pytest.approx(example.depth.depth_unit)
            assert row["camera_position_none"] == list(example.depth.cameras[k].position)
            poses = example.particles.tool_poses
            assert row["state"][0] == pytest.approx(poses.opening[k])
            assert row["state"][8:11] == pytest.approx(poses.position[k, 1].tolist())


def test_what_was_not_made_is_null(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without topology and depth there are still rows; without particles their columns are gone."""
    write_examples(new_writer(tmp_path / "d"), [RING], layers=("sim",))
    opened = open_dataset(tmp_path / "d")
    HuggingFace().export(opened, [0], tmp_path / "out", particles=False)
    rows = load(tmp_path / "out", tmp_path / "cache", monkeypatch)["train"]
    assert rows["num_components"][:] == [None] * NUM_FRAMES
    assert not {"positions", "labels", "depth_none"} & set(rows.column_names)


def test_several_views_have_columns_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sensor with two views gives `depth_<sensor>_0` and `_1`; a key frame that a view lacks has
    null there."""
    depth = RING.depth
    view = np.array([0, 1, 0], np.int32)
    two = replace(depth, view_index=view, frame_index=np.array([0, 0, 2], np.int32))
    write_examples(new_writer(tmp_path / "d"), [replace(RING, depth=two)])
    HuggingFace().export(open_dataset(tmp_path / "d"), [0], tmp_path / "out")
    rows = load(tmp_path / "out", tmp_path / "cache", monkeypatch)["train"]
    assert np.array_equal(np.array(rows[0]["depth_none_1"]), depth.depth[1])
    assert np.array_equal(np.array(rows[2]["depth_none_0"]), depth.depth[2])
    assert [rows[1]["depth_none_0"], rows[2]["depth_none_1"]] == [None, None]


def test_bad_requests_leave_nothing(dataset: Path, tmp_path: Path) -> None:
    """An unknown sensor, no scene, or a folder with something in it: one line, nothing written."""
    opened = open_dataset(dataset)
    with pytest.raises(MissingLayerError, match=r"no depth from 'kinect'.*render --noise kinect"):
        HuggingFace().export(opened, [0], tmp_path / "out", sensors="kinect")
    with pytest.raises(BadInputError, match="no scene"):
        HuggingFace().export(opened, [], tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(BadInputError, match="new or empty"):
        HuggingFace().export(opened, [0], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]
