"""The table: how well shapes and topologies are reconstructed and predicted, scene by scene.

Rows, each a mean over frames: `reconstruction` (every frame from its own view), `ceiling` (the same
without the first frame: what perfect dynamics would reach), `single_step` (each frame from the view
before it), `full_sequence` (all from the first view), `final` (its last frame), `copy_first_frame`
(the true first frame for all others: what a model must beat). `unlabelled` repeats rows with an
encoder that is not told which component a point belongs to. Each has its interval over scenes.
"""

import time
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
from doughnet.model import DoughNet
from doughnet.tables import Scored, table_row, with_steps
from doughschemas import NO_COMPONENT

__all__ = ["Timer", "Truth", "evaluate", "score_frame", "scored"]

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


STEPWISE = ("single_step", "full_sequence")
Rows = dict[str, list[list[Scored]]]  # frames of every scene


@torch.inference_mode()
def evaluate(
    model: DoughNet,
    dataset: DoughSequences,
    *,
    lattice: Lattice | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """The table of a model over whole sequences, in percent.

    `fps` counts predicted key frames a second of this process, geometry and topology, one scene
    after the other. `single_step` and `full_sequence` also come by step and by scene.

    Args:
        model: on the CPU, in evaluation mode.
        dataset: whole scenes (`length=None`).
        lattice: nodes that are compared; the workspace in millimetres by default.
        progress: hears of every scene that is done.
    """
    lattice = lattice or workspace_lattice()
    rows: Rows = defaultdict(list)
    blind: Rows = defaultdict(list)
    inconsistent, timer = 0, Timer()
    for index in range(len(dataset)):
        sample = dataset[index]
        pairs = zip(sample["scene_index"].tolist(), sample["frame_index"].tolist(), strict=True)
        frames = [dataset.source.frame(scene=scene, frame=frame) for scene, frame in pairs]
        truths = [Truth.of_frame(frame, lattice) for frame in frames]
        inconsistent += _score_scene(model, sample, truths, lattice, rows, timer)
        _score_unlabelled(model, sample, truths, lattice, blind)
        if progress is not None:
            progress(index + 1, len(dataset))
    final = table_row(rows.pop("copy_final")) if "copy_final" in rows else {}
    table = {
        name: with_steps(scenes) if name in STEPWISE else table_row(scenes)
        for name, scenes in rows.items()
    }
    if final:
        table["copy_first_frame"]["final_viou"] = final["viou"]
    return {
        "scenes": len(dataset),
        **table,
        "inconsistent": inconsistent,
        "fps": timer.per_second,
        "unlabelled": {name: table_row(scenes) for name, scenes in blind.items()},
    }


class Timer:
    """Counts what is predicted, and the seconds that it takes."""

    def __init__(self) -> None:
        self.seconds, self.count, self._start = 0.0, 0, 0.0

    def __enter__(self) -> "Timer":
        self._start = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._start

    @property
    def per_second(self) -> float:
        """Predicted frames a second."""
        return round(self.count / self.seconds, 2) if self.seconds else 0.0


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


def scored(labels: Any, genus: Sequence[int], truth: Truth, lattice: Lattice) -> Scored:
    """`score_frame`, with the class of the true frame."""
    return Scored(score=score_frame(labels, genus, truth, lattice), topology=truth.topology)


def _score_scene(
    model: DoughNet,
    sample: dict[str, Tensor],
    truths: Sequence[Truth],
    lattice: Lattice,
    rows: Rows,
    timer: Timer,
) -> int:
    """Add a scene to all rows; returns in how many predicted frames masks and genera disagree."""
    seen = model.encode(sample["points"], sample["point_labels"])
    steps, tools = len(truths) - 1, sample["tool_points"]
    rows["reconstruction"].append(_scored(model, seen, truths, lattice))
    if steps == 0:
        return 0
    rows["ceiling"].append(rows["reconstruction"][-1][1:])
    pairs = torch.stack([tools[:-1], tools[1:]], dim=1)
    single = model.rollout(seen[:-1], pairs)[:, 0]
    rows["single_step"].append(_scored(model, single, truths[1:], lattice))
    with timer:
        first = model.encode(sample["points"][:1], sample["point_labels"][:1])
        shapes = [model.decode(z, lattice) for z in model.rollout(first, tools[None])[0]]
        found = [shape.components() for shape in shapes]
    timer.count += steps
    full = [
        scored(labels, genus, truth, lattice)
        for (labels, genus), truth in zip(found, truths[1:], strict=True)
    ]
    begin = truths[0]
    copied = [scored(begin.labels, begin.genus, truth, lattice) for truth in truths[1:]]
    rows["full_sequence"].append(full)
    rows["final"].append(full[-1:])
    rows["copy_first_frame"].append(copied)
    rows["copy_final"].append(copied[-1:])
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
    rows["reconstruction"].append(_scored(model, seen, truths, lattice))
    if len(truths) == 1:
        return
    latents = model.rollout(seen[:1], sample["tool_points"][None])[0]
    rows["full_sequence"].append(_scored(model, latents, truths[1:], lattice))
    rows["final"].append(rows["full_sequence"][-1][-1:])


def _scored(
    model: DoughNet, latents: Iterable[Tensor], truths: Sequence[Truth], lattice: Lattice
) -> list[Scored]:
    """Metrics of the shapes of some latents, one after the other."""
    return [
        scored(*model.decode(z_TD, lattice).components(), truth, lattice)
        for z_TD, truth in zip(latents, truths, strict=True)
    ]
