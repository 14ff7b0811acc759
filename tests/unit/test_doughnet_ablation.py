"""Differences between trainings: against closed forms, and against scenes that are hard for all."""

import numpy as np
import pytest

from doughnet.analysis.ablation import compare, per_scene
from doughschemas import BadInputError


def test_the_mean_is_over_frames_and_the_difference_over_pairs() -> None:
    """Scenes weigh as their frames; a constant difference has an interval of no width, however
    much the scenes differ.
    """
    rng = np.random.default_rng(0)
    frames = np.array([12, 12, 6, 3])
    base = rng.uniform(10, 90, (3, 4))
    found = compare(base - 7.0, base, frames)
    assert found.value == pytest.approx(np.average(base.mean(0), weights=frames) - 7.0)
    assert found.difference == pytest.approx(-7.0)
    assert found.difference_interval == pytest.approx((-7.0, -7.0))
    assert found.resolved
    low, high = found.interval
    assert low < found.value < high


def test_the_interval_is_that_of_both_kinds_of_chance() -> None:
    """Of many seeds and scenes with normal effects of both: 1.96 standard errors, within 15 %."""
    rng = np.random.default_rng(1)
    seeds, scenes = 60, 80
    noise = rng.normal(0, 3, (seeds, 1)) + rng.normal(0, 4, (1, scenes))
    found = compare(noise, np.zeros_like(noise), np.full(scenes, 12))
    low, high = found.difference_interval
    error = np.hypot(3 / np.sqrt(seeds), 4 / np.sqrt(scenes))
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=0.15)


def test_no_difference_is_not_resolved() -> None:
    """Where half of the scenes gain what the others lose, there is none."""
    base = np.full((3, 20), 50.0)
    change = np.tile([5.0, -5.0], 10)
    found = compare(base + change, base, np.full(20, 12))
    assert found.difference == pytest.approx(0.0)
    assert not found.resolved


def test_tables_of_other_scenes_are_refused() -> None:
    """Rows of one seed have to be those of the next."""
    row = {"by_scene": [{"viou": 80.0, "frames": 12}, {"viou": 60.0, "frames": 12}]}
    short = {"by_scene": row["by_scene"][:1]}
    values, frames = per_scene([{"full_sequence": row}] * 2, "full_sequence", "viou")
    assert values.tolist() == [[80.0, 60.0]] * 2
    assert frames.tolist() == [12, 12]
    for tables in ([], [{"full_sequence": row}, {"full_sequence": short}]):
        with pytest.raises(BadInputError, match="same scenes"):
            per_scene(tables, "full_sequence", "viou")
