"""How predictions go wrong over a sequence, and how often the model contradicts itself."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from doughdata.torch import DoughSequences
from doughnet.evaluate import Truth, scored
from doughnet.lattice import Lattice, workspace_lattice
from doughnet.model import DoughNet, Shape
from doughnet.tables import Scored, summary

__all__ = ["Errors", "Failure", "sequence_errors"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A predicted frame whose topology is wrong."""

    scene_index: int
    frame_index: int
    volume_iou: float
    predicted: tuple[int, ...]  # genera, sorted
    true: tuple[int, ...]
    inconsistent: bool  # masks and genus head name different components


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Full sequences of all scenes, step by step; step 0 is what the first view was taken for."""

    by_step: tuple[dict[str, float], ...]  # the figures of `evaluate`, in percent
    first_wrong: int  # scenes whose first reconstruction has a wrong topology
    corrected: tuple[float, ...]  # percent of these that are right, at every step
    inconsistent: float  # percent of predicted frames
    failures: tuple[Failure, ...]  # worst volume first


@torch.inference_mode()
def sequence_errors(
    model: DoughNet,
    dataset: DoughSequences,
    *,
    lattice: Lattice | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Errors:
    """Predict every scene from its first view and compare every frame."""
    lattice = lattice or workspace_lattice()
    steps: dict[int, list[Scored]] = defaultdict(list)
    right: list[list[bool]] = []
    failures: list[Failure] = []
    inconsistent = predicted = 0
    for index in range(len(dataset)):
        sample = dataset[index]
        first = model.encode(sample["points"][:1], sample["point_labels"][:1])
        latents = first
        if len(sample["genus"]) > 1:
            latents = torch.cat([first, model.rollout(first, sample["tool_points"][None])[0]])
        own = []
        for step, z_TD in enumerate(latents):
            shape = model.decode(z_TD, lattice)
            place = int(sample["scene_index"][step]), int(sample["frame_index"][step])
            one = _scored(dataset, shape, place, lattice)
            steps[step].append(one)
            own.append(one.score.right_genus)
            if step:
                predicted += 1
                inconsistent += not shape.consistent
                if not one.score.right_genus:
                    failures.append(_failure(shape, place, one))
        right.append(own)
        if progress is not None:
            progress(index + 1, len(dataset))
    wrong = [own for own in right if not own[0]]
    return Errors(
        by_step=tuple(summary(steps[k]) for k in sorted(steps)),
        first_wrong=len(wrong),
        corrected=tuple(_share(own[k] for own in wrong if k < len(own)) for k in sorted(steps)),
        inconsistent=100 * inconsistent / max(predicted, 1),
        failures=tuple(sorted(failures, key=lambda one: one.volume_iou)),
    )


def _scored(
    dataset: DoughSequences, shape: Shape, place: tuple[int, int], lattice: Lattice
) -> Scored:
    frame = dataset.source.frame(scene=place[0], frame=place[1])
    return scored(*shape.components(), Truth.of_frame(frame, lattice), lattice)


def _failure(shape: Shape, place: tuple[int, int], one: Scored) -> Failure:
    return Failure(
        scene_index=place[0],
        frame_index=place[1],
        volume_iou=one.score.volume_iou,
        predicted=tuple(sorted(g for g in shape.genus if g is not None)),
        true=one.topology,
        inconsistent=not shape.consistent,
    )


def _share(values: Any) -> float:
    found = list(values)
    return 100 * sum(found) / len(found) if found else 0.0
