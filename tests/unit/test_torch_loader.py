"""The PyTorch loader: same samples for any number of workers, and one step of learning."""

import pickle

import numpy as np
import pytest
import torch
import trimesh
from torch.utils.data import DataLoader

from doughdata.dataset import open_dataset
from doughdata.scenes import finger_mesh, finger_poses
from doughdata.torch import DoughDataset
from doughschemas import BadInputError, MissingLayerError
from tests.closed_form import NUM_FRAMES, SPACING, cut_ring, joined_bars
from tests.dataset_helpers import LAYERS, new_writer, write_examples

EXAMPLES = [cut_ring(), joined_bars()]
OPTIONS = {"sensor": "none", "num_points": 64, "num_queries": 256, "num_tool_points": 32}


@pytest.fixture(scope="module")
def uri(tmp_path_factory):
    path = tmp_path_factory.mktemp("torch") / "dataset"
    return write_examples(new_writer(path), EXAMPLES).uri


def samples(dataset, **options) -> list[dict[str, torch.Tensor]]:
    return list(DataLoader(dataset, batch_size=None, **options))


def same(a, b) -> bool:
    return all(
        x.keys() == y.keys() and all(torch.equal(x[k], y[k]) for k in x)
        for x, y in zip(a, b, strict=True)
    )


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_samples_do_not_depend_on_workers(uri, method):
    """Two workers, however they were started, give the samples of none, also in a later epoch."""
    dataset = DoughDataset(uri, **OPTIONS)
    alone = samples(dataset)
    loader = DataLoader(
        dataset,
        batch_size=None,
        num_workers=2,
        multiprocessing_context=method,
        persistent_workers=True,
    )
    assert same(list(loader), alone)
    dataset.set_epoch(1)
    later = list(loader)
    assert not same(later, alone)
    assert same(later, samples(dataset))
    dataset.set_epoch(0)
    assert same(samples(pickle.loads(pickle.dumps(dataset))), alone)


def test_one_step_from_two_workers_lowers_the_loss(uri):
    """A tiny occupancy model learns from a loader with two workers: a step lowers its loss."""
    torch.manual_seed(0)
    model = torch.nn.Sequential(
        torch.nn.Linear(3, 32), torch.nn.ReLU(), torch.nn.Linear(32, 1), torch.nn.Flatten(0)
    )
    optimiser = torch.optim.SGD(model.parameters(), lr=0.01)
    loader = DataLoader(
        DoughDataset(uri, **OPTIONS), batch_size=6, num_workers=2, multiprocessing_context="spawn"
    )
    (batch,) = loader
    full = (batch["query_labels"] < batch["num_components"][:, None]).float().flatten()

    def loss() -> torch.Tensor:
        logits = model(batch["queries"].flatten(0, 1) / 0.1)
        return torch.nn.functional.binary_cross_entropy_with_logits(logits, full)

    before = loss()
    before.backward()
    optimiser.step()
    assert loss().item() < before.item()


def test_samples_agree_with_the_closed_form(uri):
    """Points lie on cubes of their label, queries are labelled by the cube they lie in."""
    dataset = DoughDataset(uri, **OPTIONS)
    assert len(dataset) == 2 * NUM_FRAMES
    for sample in samples(dataset):
        example = EXAMPLES[int(sample["scene_index"])]
        k = int(sample["frame_index"])
        frame = example.topology.frames[k]
        assert int(sample["num_components"]) == frame.num_components
        assert tuple(sample["genus"][: frame.num_components].tolist()) == frame.genus
        assert set(sample["genus"][frame.num_components :].tolist()) == {-1}
        centres = example.particles.positions[k].astype(float)
        points = sample["points"].numpy().astype(float)
        gap = np.abs(points[:, None] - centres).max(axis=2) - SPACING / 2
        # Depth is rounded to 0.1 mm, so a point may lie half a unit off the face it was seen on.
        on_label = np.where(frame.labels == sample["point_labels"].numpy()[:, None], gap, np.inf)
        assert np.all(on_label.min(axis=1) < 6e-5)
        queries = sample["queries"].numpy().astype(float)
        gap = np.abs(queries[:, None] - centres).max(axis=2) - SPACING / 2
        nearest, sure = gap.argmin(axis=1), np.abs(gap.min(axis=1)) > SPACING / 2
        inside = gap.min(axis=1) < 0
        expected = np.where(inside, frame.labels[nearest], frame.num_components)
        assert np.array_equal(sample["query_labels"].numpy()[sure], expected[sure])
        assert sure.mean() > 0.5


def test_tool_points_lie_on_the_fingers(uri):
    """Every tool point is on the surface of the finger mesh at its closed-form pose."""
    for sample in samples(DoughDataset(uri, **OPTIONS)):
        scene = EXAMPLES[int(sample["scene_index"])].scene
        action, k = scene.actions[0], int(sample["frame_index"])
        opening = np.linspace(action.opening_start, action.opening_end, NUM_FRAMES)[k]
        positions, quaternions = finger_poses(action, opening)
        for points, position, quaternion in zip(
            sample["tool_points"].numpy(), positions, quaternions, strict=True
        ):
            mesh = finger_mesh(scene.tools[0])
            turn = trimesh.transformations.quaternion_matrix(np.roll(quaternion, 1))
            turn[:3, 3] = position
            mesh.apply_transform(turn)
            _, distance, _ = trimesh.proximity.closest_point_naive(mesh, points.astype(float))
            assert distance.max() < 1e-6


def test_choice_of_split_and_frames(uri):
    """Only views of the wanted split and key frames are served; nothing left is an error."""
    dataset = DoughDataset(uri, split="train", frames=(0, 2), **OPTIONS)
    assert [int(s["frame_index"]) for s in samples(dataset)] == [0, 2, 0, 2]
    with pytest.raises(BadInputError, match="no view is left"):
        DoughDataset(uri, split="test", **OPTIONS)
    with pytest.raises(BadInputError, match="max_components"):
        samples(DoughDataset(uri, max_components=1, **OPTIONS))


def test_missing_layer_names_the_command(uri, tmp_path):
    """A sensor that was not rendered is an error that tells how to render it."""
    with pytest.raises(MissingLayerError, match="doughdata render --noise realsense"):
        DoughDataset(uri)
    bare = write_examples(new_writer(tmp_path / "bare"), EXAMPLES, layers=LAYERS[:3])
    with pytest.raises(MissingLayerError, match="doughdata render --noise none"):
        open_dataset(bare.uri).frame(scene=0, frame=0).depth("none")


def test_a_view_without_dough_is_padding(tmp_path):
    """If a camera sees no dough, the points are zeros with label -1 and the rest is still there."""
    from dataclasses import replace

    ring = EXAMPLES[0]
    blind = replace(ring, depth=replace(ring.depth, segments=np.minimum(ring.depth.segments, 1)))
    uri = write_examples(new_writer(tmp_path / "blind"), [blind]).uri
    sample = DoughDataset(uri, **OPTIONS)[0]
    assert not sample["points"].any()
    assert set(sample["point_labels"].tolist()) == {-1}
    assert (sample["query_labels"] == 0).any()
