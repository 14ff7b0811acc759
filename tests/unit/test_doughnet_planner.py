"""Planning with random dynamics: the squeeze that made a goal is found again."""

from collections.abc import Sequence

import numpy as np
import pytest
import torch

from doughnet.config import micro
from doughnet.model import DoughNet
from doughnet.planner import Planner
from doughnet.search import SearchConfig, Squeeze
from doughschemas import BadInputError

WIDTHS = {"thin": 0.002, "broad": 0.02}


class Bars:
    """Two bars that close to a squeeze's opening in four key frames."""

    tools = tuple(WIDTHS)

    def points(self, squeezes: Sequence[Squeeze]) -> np.ndarray:
        """See `Gripper`."""
        side = np.linspace(-1, 1, 16)
        rows = []
        for s in squeezes:
            c, n = np.cos(s.yaw), np.sin(s.yaw)
            frames = []
            for share in np.linspace(0, 1, 4):
                half = (0.05 + (s.opening - 0.05) * share) / 2
                bar = np.stack([np.full(16, half), WIDTHS[s.tool] * side, 0.02 + 0.02 * side], 1)
                both = np.stack([bar, bar * [-1, 1, 1]])
                turned = both @ np.array([[c, n, 0], [-n, c, 0], [0, 0, 1.0]])
                frames.append(turned + np.array([*s.position, 0.0]))
            rows.append(frames)
        return np.array(rows, np.float32)

    def free(self, squeezes: Sequence[Squeeze]) -> np.ndarray:
        """See `Gripper`: dough fills the half x < 0, where no squeeze may begin."""
        return np.array([s.position[0] >= 0 for s in squeezes])


@pytest.fixture(scope="module")
def model() -> DoughNet:
    """Random weights everywhere, dynamics that react to the tool included."""
    torch.manual_seed(0)
    net = DoughNet(micro()).eval()
    with torch.no_grad():
        for weight in net.dynamics.parameters():
            if weight.ndim == 2:
                torch.nn.init.xavier_normal_(weight, gain=2.0)
    return net


def dough(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.03, -0.03, 0], [0.03, 0.03, 0.02], (256, 3))
    return torch.from_numpy(points).float(), torch.from_numpy((points[:, 0] > 0).astype(np.int64))


def test_scores_are_cosines_of_the_last_latents(model: DoughNet) -> None:
    """Against the definition, squeeze by squeeze; the goal's own numbering of components is one
    of those that are tried."""
    planner = Planner(model, Bars(), start=dough(0), goal=dough(1))
    squeezes = [
        Squeeze(tool=tool, position=(0.01 * k, 0.0), yaw=0.05 * k, opening=0.005)
        for k, tool in enumerate(["thin", "broad", "thin"])
    ]
    points, labels = dough(1)
    with torch.inference_mode():
        start = model.encode(dough(0)[0][None], dough(0)[1][None])
        goals = [model.encode(points[None], own[None])[0] for own in (labels, 1 - labels)]
        for squeeze, score in zip(squeezes, planner.scores(squeezes), strict=True):
            tools = torch.from_numpy(Bars().points([squeeze]))
            end = model.rollout(start, tools)[0, -1]
            cosines = [torch.cosine_similarity(end.flatten(), g.flatten(), dim=0) for g in goals]
            assert score == pytest.approx(float(max(cosines)), abs=1e-5)


def test_what_begins_in_the_dough_has_no_score(model: DoughNet) -> None:
    """It is NaN and never part of a plan; a gripper that nothing is free for is told in a line."""
    planner = Planner(model, Bars(), start=dough(0), goal=dough(1))
    squeezes = [
        Squeeze(tool="thin", position=(x, 0.0), yaw=0.0, opening=0.005)
        for x in np.linspace(-0.02, 0.02, 40)
    ]
    scores = planner.scores(squeezes)
    free = [squeezes[k] for k in range(40) if squeezes[k].position[0] >= 0]
    assert np.isnan(scores[:20]).all()
    np.testing.assert_allclose(scores[20:], planner.scores(free), atol=1e-6)
    plan = planner.plan(SearchConfig(samples=12, elites=8, iterations=2, seed=1))
    assert all(s.position[0] >= 0 for found in plan.rounds for s in found.squeezes)
    assert all(len(found.squeezes) == len(found.scores) for found in plan.rounds)
    nothing = Bars()
    nothing.free = lambda squeezes: np.zeros(len(squeezes), bool)
    with pytest.raises(BadInputError, match="begin in the dough"):
        Planner(model, nothing, start=dough(0), goal=dough(1)).plan(SearchConfig(samples=8))


def test_names_of_components_do_not_matter(model: DoughNet) -> None:
    """A goal whose two components are numbered the other way round scores the same."""
    points, labels = dough(1)
    squeeze = Squeeze(tool="thin", position=(0.0, 0.0), yaw=0.0, opening=0.002)
    one = Planner(model, Bars(), start=dough(0), goal=(points, labels)).scores([squeeze])
    two = Planner(model, Bars(), start=dough(0), goal=(points, 3 - 2 * labels)).scores([squeeze])
    assert one == pytest.approx(two, abs=1e-4)


@pytest.mark.slow
def test_the_squeeze_that_made_the_goal_is_found(model: DoughNet) -> None:
    """Scored by the latents that a known squeeze leads to, the search comes back to it."""
    wanted = Squeeze(tool="broad", position=(0.009, -0.006), yaw=-0.1, opening=0.004)
    planner = Planner(model, Bars(), start=dough(0), goal=dough(0))
    end = planner.latents([wanted])[:, -1]
    planner._goals = torch.nn.functional.normalize(end.flatten(1), dim=-1)
    told: list[tuple[int, int, float]] = []
    plan = planner.plan(SearchConfig(seed=1), progress=lambda *step: told.append(step))
    assert plan.squeeze.tool == wanted.tool
    assert np.hypot(*np.subtract(plan.squeeze.position, wanted.position)) < 1.5e-3
    assert abs(np.degrees(plan.squeeze.yaw - wanted.yaw)) < 1.5
    assert plan.score > planner.scores([Squeeze(tool="thin", position=(0, 0), yaw=0, opening=0.01)])
    assert [step[:2] for step in told] == [(k, 10) for k in range(1, 11)]
    assert len(plan.rounds) == 10
