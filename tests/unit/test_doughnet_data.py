"""Sequences and their order: windows, workers, ranks, and going on from any position."""

from collections import Counter
from itertools import islice

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from doughdata.torch import DoughDataset, DoughSequences, EndlessSampler
from doughnet.config import ModelConfig
from doughnet.data import (
    EndlessBatches,
    LoaderConfig,
    balancing,
    class_weights,
    key_frames,
)
from doughschemas import BadInputError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

OPTIONS = {"sensor": "none", "num_points": 32, "num_queries": 64, "num_tool_points": 16}


@pytest.fixture(scope="module")
def uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("sequences") / "dataset"
    return write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)


def test_a_sequence_is_its_single_frames_stacked(uri: str) -> None:
    """Every tensor of a window is the stack of what the single views serve."""
    single = DoughDataset(uri, **OPTIONS)
    of = {(int(s["scene_index"]), int(s["frame_index"])): s for s in (single[k] for k in range(6))}
    whole = DoughSequences(uri, length=None, **OPTIONS)
    assert len(whole) == 2
    for index in range(2):
        sample = whole[index]
        keys = zip(sample["scene_index"].tolist(), sample["frame_index"].tolist(), strict=True)
        frames = [of[key] for key in keys]
        assert len(frames) == NUM_FRAMES
        assert same(sample, {n: torch.stack([f[n] for f in frames]) for n in sample})


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"length": 2}, [[0, 1], [1, 2]]),
        ({"length": 2, "stride": 2}, [[0, 2]]),
        ({"length": None, "stride": 2}, [[0, 2]]),
        ({"length": 2, "frames": (0, 2)}, [[0, 2]]),
        ({"length": 1}, [[0], [1], [2]]),
    ],
)
def test_windows(uri: str, options: dict, expected: list[list[int]]) -> None:
    """Windows step through the chosen key frames of one scene, never from scene to scene."""
    data = DoughSequences(uri, **options, **OPTIONS)
    found = [data[k]["frame_index"].tolist() for k in range(len(data))]
    assert found == expected * 2
    assert all(len(set(data[k]["scene_index"].tolist())) == 1 for k in range(len(data)))


def test_impossible_windows_are_told(uri: str) -> None:
    """More frames than a scene has, or none at all, are errors that say what to do."""
    with pytest.raises(BadInputError, match="--all-frames"):
        DoughSequences(uri, length=NUM_FRAMES + 1, **OPTIONS)
    with pytest.raises(BadInputError, match="at least 1"):
        DoughSequences(uri, length=0, **OPTIONS)


def test_an_order_is_a_permutation_an_epoch_and_goes_on_anywhere() -> None:
    """Each epoch serves every index once, in another order; from any position the rest is the
    same; ranks share an epoch without overlap.
    """
    data = list(range(10))
    start = list(islice(EndlessSampler(data, seed=3), 40))
    for epoch in range(4):
        part = start[10 * epoch : 10 * epoch + 10]
        assert {e for e, _ in part} == {epoch}
        assert sorted(k for _, k in part) == data
    assert start[:10] != [(0, k) for _, k in start[10:20]]
    assert list(islice(EndlessSampler(data, seed=3, start=17), 23)) == start[17:]
    ranks = [list(islice(EndlessSampler(data, rank=r, world_size=3), 3)) for r in range(3)]
    assert len({index for rank in ranks for index in rank}) == 9
    with pytest.raises(ValueError, match="rank 3 of 3"):
        EndlessSampler(data, rank=3, world_size=3)


def test_a_weighted_order_draws_by_weight_and_goes_on_anywhere() -> None:
    """Samples come as often as their weights say; no draw has the number of another; from any
    position, and for any number of ranks, the draws are the same.
    """
    data, weights = list(range(4)), [0.0, 1.0, 2.0, 5.0]
    start = list(islice(EndlessSampler(data, weights=weights, seed=3), 4000))
    number = Counter(index for _, index in start)
    assert number[0] == 0
    for index, weight in enumerate(weights):
        chance = weight / 8
        assert abs(number[index] - 4000 * chance) <= 5 * (4000 * chance * (1 - chance)) ** 0.5
    assert [draw for draw, _ in start] == list(range(4000))
    later = EndlessSampler(data, weights=weights, seed=3, start=17)
    assert list(islice(later, 23)) == start[17:40]
    ranks = [
        islice(EndlessSampler(data, weights=weights, seed=3, rank=r, world_size=2), 50)
        for r in range(2)
    ]
    assert sorted(pair for rank in ranks for pair in rank) == start[:100]


@pytest.mark.parametrize("weights", [[1.0], [1.0, -1.0], [0.0, 0.0], [1.0, float("nan")]])
def test_impossible_weights_are_told(weights: list[float]) -> None:
    """One weight a sample, none below zero, and something to draw."""
    with pytest.raises(ValueError, match="2 finite numbers from 0 on"):
        EndlessSampler([0, 1], weights=weights)


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_go_on_from_any_step(uri: str, workers: int) -> None:
    """Batches from step 2 on are those that a run from step 0 sees, for any number of workers."""
    data = DoughDataset(uri, **OPTIONS)
    batches = EndlessBatches(data, LoaderConfig(batch_size=4, workers=workers, seed=1))
    alone = EndlessBatches(data, LoaderConfig(batch_size=4, workers=0, seed=1))
    whole = list(islice(alone(0), 4))
    later = list(islice(batches(2), 2))
    assert all(same(a, b) for a, b in zip(whole[2:], later, strict=True))
    assert not same(whole[0], whole[3])


def test_an_epoch_comes_with_the_index(uri: str) -> None:
    """A pair (epoch, index) gives what `set_epoch` and the index give."""
    data = DoughDataset(uri, **OPTIONS)
    pair = data[2, 1]
    assert not same(pair, data[1])
    data.set_epoch(2)
    assert same(pair, data[1])
    (loaded,) = islice(DataLoader(data, batch_size=None, sampler=[(2, 1)]), 1)
    assert same(loaded, pair)


def test_rare_genera_weigh_more(uri: str) -> None:
    """Weights are 1 / sqrt(frequency) of components and free places, one on average; a sample that
    is drawn twice as often counts twice.
    """
    data = DoughDataset(uri, **OPTIONS)
    assert key_frames(data.source, "none") == (0, 1, 2)
    config = ModelConfig(components=2, max_genus=2)
    genera = [(*f.genus, 3, 3)[:2] for e in (cut_ring(), joined_bars()) for f in e.topology.frames]
    for drawn in (None, np.arange(1.0, 7.0)):
        weights = class_weights(data, config, drawn)
        number = torch.zeros(4)
        for found, times in zip(genera, drawn if drawn is not None else np.ones(6), strict=True):
            for g in found:
                number[g] += times
        there = number > 0
        torch.testing.assert_close(weights[~there], torch.zeros(int((~there).sum())))
        ratio = weights[there] * (number[there] / number.sum()).sqrt()
        torch.testing.assert_close(ratio, ratio[:1].expand_as(ratio))
        assert (weights * number).sum().item() / number.sum().item() == pytest.approx(1.0)


def test_a_topology_is_drawn_by_the_root_of_its_frequency(uri: str) -> None:
    """All samples of a topology together weigh the root of their number; windows count for their
    last key frame.
    """
    data, windows = DoughDataset(uri, **OPTIONS), DoughSequences(uri, length=2, **OPTIONS)
    for samples in (data, windows):
        weights, total = balancing(samples), Counter()
        number = Counter()
        for k, weight in enumerate(weights):
            genus = samples[k]["genus"].reshape(-1, 8)[-1]
            topology = tuple(sorted(g for g in genus.tolist() if g >= 0))
            total[topology] += float(weight)
            number[topology] += 1
        assert len(number) > 1
        assert total == pytest.approx({found: count**0.5 for found, count in number.items()})
