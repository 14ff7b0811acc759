"""The table: how well shapes and topologies are reconstructed and predicted, scene by scene.

Rows, each a mean over frames: `reconstruction` (every frame from its own view), `ceiling` (the same
without the first frame: what perfect dynamics would reach), `single_step` (each frame from the view
before it), `full_sequence` (all from the first view), `final` (its last frame), `copy_first_frame`
(the true first frame for all others: what a model must beat). `unlabelled` repeats rows with an
encoder that is not told which component a point belongs to.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Int, Integer
from torch import Tensor

from doughdata.dataset import Frame
from doughdata.torch import DoughSequences
from doughdata.torch.sampling import inside_tools
from doughnet.lattice import Lattice, on_lattice, workspace_lattice
from doughnet.metrics import TopologyScore, score
from doughnet.model import DoughNet, Shape
from doughschemas import NO_COMPONENT

__all__ = ["Row", "Scored", "Truth", "evaluate", "score_frame", "summary"]

Progress = Callable[[int, int], None]  # scenes done, scenes in all


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What is true of one key frame."""

    labels: Int[Tensor, "nx ny nz"]  # component of every node; others are empty
    genus: tuple[int, ...]
    tools: Any  # `FrameTools`

    @classmethod
    def of(
        cls, labels: Integer[np.ndarray, "nx ny nz"], genus: Sequence[int], tools: Any
    ) -> "Truth":
        """From labels on the lattice as numpy has them."""
        labels = np.ascontiguousarray(labels, np.int64)
        return cls(labels=torch.from_numpy(labels), genus=tuple(genus), tools=tools)

    @classmethod
    def of_frame(cls, frame: Frame, lattice: Lattice) -> "Truth":
        """Of a simulated key frame."""
        return cls.of(on_lattice(frame.label_grid, lattice), frame.genus, frame.tools)

    @property
    def topology(self) -> tuple[int, ...]:
        """The frame's class for balanced accuracy: its components' genera, sorted."""
        return tuple(sorted(self.genus))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """Metrics of one predicted frame, and the class of the true one."""

    score: TopologyScore
    topology: tuple[int, ...]


Rows = dict[str, list[Scored]]
Row = dict[str, float]


@torch.inference_mode()
def evaluate(
    model: DoughNet,
    dataset: DoughSequences,
    *,
    lattice: Lattice | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """The table of a model over whole sequences, in percent.

    Args:
        model: on the CPU, in evaluation mode.
        dataset: whole scenes (`length=None`).
        lattice: nodes that are compared; the workspace in millimetres by default.
        progress: hears of every scene that is done.
    """
    lattice = lattice or workspace_lattice()
    rows: Rows = defaultdict(list)
    blind: Rows = defaultdict(list)
    inconsistent = 0
    for index in range(len(dataset)):
        sample = dataset[index]
        pairs = zip(sample["scene_index"].tolist(), sample["frame_index"].tolist(), strict=True)
        frames = [dataset.source.frame(scene=scene, frame=frame) for scene, frame in pairs]
        truths = [Truth.of_frame(frame, lattice) for frame in frames]
        inconsistent += _score_scene(model, sample, truths, lattice, rows)
        _score_unlabelled(model, sample, truths, lattice, blind)
        if progress is not None:
            progress(index + 1, len(dataset))
    table: dict[str, Any] = {name: summary(scored) for name, scored in rows.items()}
    final = [one.score.volume_iou for one in rows["copy_final"]]
    table["copy_first_frame"]["final_viou"] = _percent(final)
    del table["copy_final"]
    return {
        "scenes": len(dataset),
        **table,
        "inconsistent": inconsistent,
        "unlabelled": {name: summary(scored) for name, scored in blind.items()},
    }


def summary(scored: Sequence[Scored]) -> Row:
    """Means of a row in percent; `balanced_accg` is the mean over the topologies that occur."""
    classes: dict[tuple[int, ...], list[bool]] = defaultdict(list)
    for one in scored:
        classes[one.topology].append(one.score.right_genus)
    return {
        "viou": _percent(one.score.volume_iou for one in scored),
        "ciou": _percent(one.score.component_iou for one in scored),
        "accc": _percent(one.score.right_count for one in scored),
        "accg": _percent(one.score.right_genus for one in scored),
        "balanced_accg": _percent(float(np.mean(right)) for right in classes.values()),
        "accg_components": _percent(one.score.genus_share for one in scored),
        "frames": len(scored),
    }


def score_frame(
    labels: Int[Tensor, "nx ny nz"] | Integer[np.ndarray, "nx ny nz"],
    genus: Sequence[int],
    truth: Truth,
    lattice: Lattice,
) -> TopologyScore:
    """Metrics of one frame over the nodes above the table and outside the tool.

    Nodes that are empty in both change no metric and are left out. `labels` below zero are dough
    of no component, those past `genus` are empty.
    """
    predicted, true = torch.as_tensor(labels).flatten(), truth.labels.flatten()
    dough = ((predicted < len(genus)) | (true < len(truth.genus))).nonzero()[:, 0]
    points = lattice.points(dough).double().numpy()
    dough = dough[torch.from_numpy(~inside_tools(truth.tools, points))]
    return score(
        predicted[dough],
        true[dough],
        predicted_genus=list(genus),
        true_genus=list(truth.genus),
    )


def _score_scene(
    model: DoughNet,
    sample: dict[str, Tensor],
    truths: Sequence[Truth],
    lattice: Lattice,
    rows: Rows,
) -> int:
    """Add a scene to all rows; returns in how many predicted frames masks and genera disagree."""
    seen = model.encode(sample["points"], sample["point_labels"])
    steps = len(truths) - 1
    tools = sample["tool_points"]
    for k, truth in enumerate(truths):
        found = _scored(model.decode(seen[k], lattice), truth, lattice)
        rows["reconstruction"].append(found)
        rows["ceiling"] += [found] if k else []
    if steps == 0:
        return 0
    pairs = torch.stack([tools[:-1], tools[1:]], dim=1)
    for k, latents in enumerate(model.rollout(seen[:-1], pairs)[:, 0]):
        rows["single_step"].append(_scored(model.decode(latents, lattice), truths[k + 1], lattice))
    shapes = [model.decode(z, lattice) for z in model.rollout(seen[:1], tools[None])[0]]
    first = truths[0]
    for shape, truth in zip(shapes, truths[1:], strict=True):
        rows["full_sequence"].append(_scored(shape, truth, lattice))
        copied = score_frame(first.labels, first.genus, truth, lattice)
        rows["copy_first_frame"].append(Scored(score=copied, topology=truth.topology))
    rows["final"].append(rows["full_sequence"][-1])
    rows["copy_final"].append(rows["copy_first_frame"][-1])
    return sum(not shape.consistent for shape in shapes)


def _score_unlabelled(
    model: DoughNet,
    sample: dict[str, Tensor],
    truths: Sequence[Truth],
    lattice: Lattice,
    rows: Rows,
) -> None:
    """The rows that start from views whose points belong to no component."""
    none = torch.full_like(sample["point_labels"], NO_COMPONENT)
    seen = model.encode(sample["points"], none)
    for k, truth in enumerate(truths):
        rows["reconstruction"].append(_scored(model.decode(seen[k], lattice), truth, lattice))
    if len(truths) == 1:
        return
    latents = model.rollout(seen[:1], sample["tool_points"][None])[0]
    for z_TD, truth in zip(latents, truths[1:], strict=True):
        rows["full_sequence"].append(_scored(model.decode(z_TD, lattice), truth, lattice))
    rows["final"].append(rows["full_sequence"][-1])


def _scored(shape: Shape, truth: Truth, lattice: Lattice) -> Scored:
    labels, genus = shape.components()
    return Scored(score=score_frame(labels, genus, truth, lattice), topology=truth.topology)


def _percent(values: Iterable[float]) -> float:
    found = list(values)
    return round(100 * float(np.mean(found)), 2) if found else 0.0
