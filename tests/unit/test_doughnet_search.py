"""The search finds the best of functions whose best is known."""

import numpy as np
import pytest

from doughnet.search import SearchConfig, Squeeze, search
from doughschemas import BadInputError

TOOLS = ("narrow", "regular", "wide")
WANTED = Squeeze(tool="regular", position=(0.012, -0.007), yaw=0.08, opening=0.004)


def distance(squeeze: Squeeze) -> float:
    """How far a squeeze is from the wanted one, in units of the first deviations."""
    off = np.subtract(squeeze.position, WANTED.position) / 0.008
    turned = (squeeze.yaw - WANTED.yaw) / np.radians(10)
    opened = (squeeze.opening - WANTED.opening) / 0.01
    wrong_tool = 0.0 if squeeze.tool == WANTED.tool else 1.0
    return float(np.sqrt(off @ off + turned**2 + opened**2)) + wrong_tool


@pytest.mark.parametrize("seed", range(5))
def test_a_bowl_has_its_bottom_found(seed: int) -> None:
    """Place within 0.5 mm, turn within 0.5 degrees, opening within 1 mm, and the tool."""
    config = SearchConfig(seed=seed)
    rounds = list(search(lambda s: np.array([-distance(x) for x in s]), TOOLS, config))
    best = rounds[-1].squeezes[0]
    assert best.tool == WANTED.tool
    assert np.hypot(*np.subtract(best.position, WANTED.position)) < 0.5e-3
    assert abs(np.degrees(best.yaw - WANTED.yaw)) < 0.5
    assert abs(best.opening - WANTED.opening) < 1e-3
    tops = [found.scores[0] for found in rounds]
    assert tops == sorted(tops)  # the best so far is never lost
    assert rounds[-1].shares[TOOLS.index("regular")] > 0.9


@pytest.mark.parametrize("wanted", [np.radians(88.0), np.radians(-89.0), 0.3])
def test_any_turn_has_no_edge(wanted: float) -> None:
    """With every turn allowed, one near a quarter turn is found from either side."""

    def score(squeezes):
        return np.array([-abs(np.sin(s.yaw - wanted)) for s in squeezes])

    config = SearchConfig(turn=np.pi / 2, turn_spread=np.pi / 2)
    best = list(search(score, TOOLS, config))[-1].squeezes[0]
    assert abs(best.yaw) <= np.pi / 2
    assert abs(np.degrees(np.arcsin(np.sin(best.yaw - wanted)))) < 2.0


def test_rounds_have_the_sizes_asked_for() -> None:
    """So many samples are scored, so many are kept, best first, in so many rounds."""
    asked: list[int] = []

    def score(squeezes):
        asked.append(len(squeezes))
        return np.array([-abs(s.yaw) for s in squeezes])

    config = SearchConfig(samples=12, elites=3, iterations=4)
    rounds = list(search(score, TOOLS, config))
    assert asked == [12] * 4
    assert all(len(r.squeezes) == len(r.scores) == 3 for r in rounds)
    assert all(list(r.scores) == sorted(r.scores, reverse=True) for r in rounds)
    assert all(np.isclose(sum(r.shares), 1.0) for r in rounds)


def test_nothing_is_drawn_out_of_bounds() -> None:
    """Even where the best lies beyond them; NaN is worse than any number."""
    config = SearchConfig(reach=0.01, turn=0.05, openings=(0.001, 0.003), iterations=6)

    def score(squeezes):
        low, high = config.bounds
        for s in squeezes:
            row = np.array([*s.position, s.yaw, s.opening])
            assert ((row >= low) & (row <= high)).all()
        values = np.array([s.position[0] for s in squeezes])
        values[::2] = np.nan
        return values

    last = list(search(score, TOOLS, config))[-1]
    assert last.squeezes[0].position[0] > 0.009
    assert np.isfinite(last.scores[0])


def test_the_same_seed_draws_the_same() -> None:
    """A search is its seed."""

    def run(seed):
        found = search(
            lambda s: np.array([-distance(x) for x in s]), TOOLS, SearchConfig(seed=seed)
        )
        return list(found)[-1].squeezes

    assert run(3) == run(3)
    assert run(3) != run(4)


@pytest.mark.parametrize(
    "wrong",
    [{"elites": 0}, {"elites": 65}, {"iterations": 0}, {"openings": (0.02, 0.01)}],
)
def test_nonsense_is_refused(wrong: dict) -> None:
    """Sizes that cannot be, in one line."""
    with pytest.raises(BadInputError, match=r"needs|rise"):
        SearchConfig(**wrong)
    with pytest.raises(BadInputError, match="at least one tool"):
        next(search(lambda s: np.zeros(len(s)), (), SearchConfig()))
