"""Change detection and embedding against closed forms and counting."""

import numpy as np
import pytest

from doughdata.dataset import open_dataset
from doughnet.analysis.changes import detector, jump_scores
from doughnet.analysis.embedding import embed
from doughnet.analysis.latents import scene_latents
from doughnet.config import ModelConfig
from doughnet.model import DoughNet
from doughschemas import BadInputError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip


def test_one_jump_has_the_greatest_score_there_can_be() -> None:
    """n - 1 equal steps, one longer: a z-score of sqrt(n - 1), of the others -1 / sqrt(n - 1)."""
    place = np.zeros((75, 3), np.float32)
    place[1:, 0] = np.cumsum([1.0] * 40 + [5.0] + [1.0] * 33)
    scores = jump_scores(place)
    steps = len(scores)
    assert scores[40] == pytest.approx(np.sqrt(steps - 1))
    np.testing.assert_allclose(np.delete(scores, 40), -1 / np.sqrt(steps - 1))
    assert (jump_scores(np.zeros((5, 2), np.float32)) == 0).all()


def counted(score: np.ndarray, truth: np.ndarray) -> float:
    """The best F1 over all thresholds, by counting."""
    best = 0.0
    for threshold in np.unique(score):
        said = score >= threshold
        hits = (said & truth).sum()
        best = max(best, 200 * hits / (said.sum() + truth.sum()))
    return best


@pytest.mark.parametrize("seed", range(5))
def test_the_best_f1_is_that_of_counting(seed: int) -> None:
    """On random scores; the area is the chance that a change outscores another step."""
    rng = np.random.default_rng(seed)
    truth = rng.random(200) < 0.1
    score = rng.normal(size=200) + 2.0 * truth
    found = detector([score[:80], score[80:]], [truth[:80], truth[80:]])
    assert found.f1 == pytest.approx(counted(score, truth))
    said = score >= found.threshold
    assert 200 * (said & truth).sum() / (said.sum() + truth.sum()) == pytest.approx(found.f1)
    pairs = (score[truth][:, None] > score[~truth][None]).mean()
    assert found.area == pytest.approx(pairs)
    assert found.positive_rate == pytest.approx(100 * truth.mean())


def test_nothing_to_tell_apart_is_told() -> None:
    """Without a change, or with nothing but changes."""
    for truth in (np.zeros(4, bool), np.ones(4, bool)):
        with pytest.raises(BadInputError, match="of 4 steps"):
            detector([np.arange(4.0)], [truth])


def test_clusters_stay_apart_on_the_plane() -> None:
    """Three clusters in 64 numbers: on the plane every frame's nearest neighbours are its own."""
    rng = np.random.default_rng(0)
    kind = np.repeat([0, 1, 2], 30)
    latents = rng.normal(size=(90, 64)) + 12.0 * rng.normal(size=(3, 64))[kind]
    latents[:, 5] = 0.0  # a number that never changes does no harm
    place = embed(latents)
    away = np.linalg.norm(place[:, None] - place[None], axis=2)
    nearest = kind[np.argsort(away, axis=1)[:, 1:6]]
    assert (nearest == kind[:, None]).mean() > 0.95


def test_latents_know_when_the_topology_changed(tmp_path) -> None:
    """Of every scene: one mean a view, genera as labelled, a change where an event lies."""
    uri = write_examples(new_writer(tmp_path / "dough"), [cut_ring(), joined_bars()]).uri
    source = open_dataset(uri)
    model = DoughNet(NANO).eval()
    told = []
    found = scene_latents(
        model, source, scenes=source.scene_indices, sensor="none",
        progress=lambda *step: told.append(step),
    )  # fmt: skip
    assert [own.scene_index for own in found] == source.scene_indices
    assert told == [(1, 2), (2, 2)]
    for own in found:
        events = {event.frame for event in source.read_topology(own.scene_index).events}
        assert own.mean.shape == (len(own.frames), 24)
        assert own.changed.sum() == len(events) > 0
        for k, frame in enumerate(own.frames.tolist()):
            label = source.frame(scene=own.scene_index, frame=frame).topology.genus
            assert own.genus[k] == tuple(sorted(label))
