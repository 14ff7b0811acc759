"""Planning in latent space: which squeeze turns the dough that is seen into the goal?

The model rolls many squeezes out at once. Each is scored by the cosine between its last latents and
those of the goal, which tell shape and topology alike (DoughNet, section 5.4).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int
from torch import Tensor

from doughnet.lattice import workspace_lattice
from doughnet.model import DoughNet
from doughnet.search import Round, SearchConfig, Squeeze, search

__all__ = ["Gripper", "Plan", "Planner", "Progress", "reconstructed"]

BATCH = 16  # squeezes rolled out at once: more do not fit into the cache of a CPU
Points = Float[np.ndarray, "N 3"] | Float[Tensor, "N 3"]
Seen = tuple[Points, Int[np.ndarray, " N"] | Int[Tensor, " N"]]
Progress = Callable[[int, int, float], None]  # rounds done, rounds in all, best score


class Gripper(Protocol):
    """Tools to choose from, and how each moves: what a planner is handed."""

    @property
    def tools(self) -> Sequence[str]:
        """Names of the tools."""
        ...

    def points(
        self, squeezes: Sequence[Squeeze]
    ) -> Float32[np.ndarray, "squeezes frames fingers points 3"]:
        """Points [m], world, on the fingers in every key frame that the model steps through."""
        ...

    def free(self, squeezes: Sequence[Squeeze]) -> Bool[np.ndarray, " squeezes"]:
        """Whether the fingers begin beside the dough, not in it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What a search found, and the way there."""

    squeeze: Squeeze
    score: float  # cosine with the goal, at most 1
    rounds: tuple[Round, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON: the squeeze, its score, and the best squeezes of every round."""
        return {
            "squeeze": _plain(self.squeeze),
            "score": self.score,
            "rounds": [
                {
                    "squeezes": [_plain(squeeze) for squeeze in found.squeezes],
                    "scores": list(found.scores),
                    "tool_shares": list(found.shares),
                }
                for found in self.rounds
            ],
        }


class Planner:
    """Plans from one start to one goal.

    Args:
        model: in evaluation mode.
        gripper: tools and their motion.
        start: points [m], world, and components of the dough as it is seen, (N, 3) and (N,).
        goal: the same of the dough as it should be; in which order its components are named does
            not matter.
    """

    def __init__(
        self,
        model: DoughNet,
        gripper: Gripper,
        *,
        start: Seen,
        goal: Seen,
    ) -> None:
        self.model, self.gripper = model, gripper
        with torch.inference_mode():
            points, labels = _tensors(start)
            self.start = model.encode(points[None], labels[None])[0]
            goals = _with_every_order(model, *_tensors(goal))
            self._goals = torch.nn.functional.normalize(goals.flatten(1), dim=-1)

    def plan(self, config: SearchConfig, progress: Progress | None = None) -> Plan:
        """Search; see `SearchConfig`.

        Raises:
            BadInputError: of all squeezes of a round, none can begin.
        """
        rounds: list[Round] = []
        for found in search(self.scores, self.gripper.tools, config):
            rounds.append(found)
            if progress is not None:
                progress(len(rounds), config.iterations, found.scores[0])
        last = rounds[-1]
        return Plan(squeeze=last.squeezes[0], score=last.scores[0], rounds=tuple(rounds))

    @torch.inference_mode()
    def scores(self, squeezes: Sequence[Squeeze]) -> Float64[np.ndarray, " squeezes"]:
        """How well the predicted end of each squeeze agrees with the goal.

        NaN for one that cannot begin: its fingers are in the dough.
        """
        found = np.full(len(squeezes), np.nan)
        free = np.flatnonzero(self.gripper.free(squeezes))
        for some in (free[k : k + BATCH] for k in range(0, len(free), BATCH)):
            ends = self.latents([squeezes[k] for k in some])[:, -1]
            units = torch.nn.functional.normalize(ends.flatten(1), dim=-1)
            found[some] = (units @ self._goals.T).amax(dim=1).double().cpu().numpy()
        return found

    @torch.inference_mode()
    def latents(self, squeezes: Sequence[Squeeze]) -> Float[Tensor, "squeezes steps T D"]:
        """Latents of all later key frames of each squeeze."""
        points = torch.from_numpy(self.gripper.points(squeezes)).to(self.start)
        return self.model.rollout(self.start.expand(len(squeezes), -1, -1), points)


@torch.inference_mode()
def reconstructed(model: DoughNet, seen: Seen) -> Float64[np.ndarray, "nodes 3"]:
    """Nodes [m], world, of the workspace's lattice that a model takes for dough."""
    lattice = workspace_lattice()
    points, labels = _tensors(seen)
    own, genus = model.decode(model.encode(points[None], labels[None])[0], lattice).components()
    return lattice.points((own.flatten() < len(genus)).nonzero()[:, 0]).double().numpy()


def _plain(squeeze: Squeeze) -> dict[str, Any]:
    return {**asdict(squeeze), "yaw_deg": math.degrees(squeeze.yaw)}


def _tensors(seen: Seen) -> tuple[Float[Tensor, "N 3"], Int[Tensor, " N"]]:
    points, labels = seen
    return torch.as_tensor(points).float(), torch.as_tensor(labels).long()


def _with_every_order(
    model: DoughNet, points: Float[Tensor, "N 3"], labels: Int[Tensor, " N"]
) -> Float[Tensor, "orders T D"]:
    """Latents of points with their components named in every order.

    The encoder tells components by their numbers, and a goal has no reason to number them as the
    prediction does.
    """
    names = [k for k in labels.unique().tolist() if 0 <= k < model.config.components]
    found = []
    for order in permutations(range(len(names))):
        renamed = torch.full_like(labels, -1)
        for name, number in zip(names, order, strict=True):
            renamed[labels == name] = number
        found.append(renamed)
    named = torch.stack(found)
    return model.encode(points.expand(len(named), -1, -1), named)
