"""One table for all ways to predict a sequence from its first view and the tool's motion."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Int, Integer
from torch import Tensor

from doughdata.dataset import Frame
from doughdata.torch import DoughSequences
from doughnet.baselines.occupancy import static_components
from doughnet.evaluate import Row, Scored, Truth, score_frame, summary
from doughnet.intervals import bootstrap
from doughnet.lattice import Lattice, on_lattice, workspace_lattice
from doughnet.model import DoughNet

__all__ = ["Copy", "Found", "Method", "Model", "Vpm", "evaluate_method"]

Found = tuple[Int[Tensor, "nx ny nz"] | Integer[np.ndarray, "nx ny nz"], Sequence[int]]
Progress = Callable[[int, int], None]


class Method(Protocol):
    """A way to predict."""

    name: str
    failed: int  # scenes that it could not predict and guessed

    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """Labels of the lattice's nodes and genera in every key frame but the first.

        Args:
            sample: the scene as `DoughSequences` serves it; of later key frames only the tool may
                be looked at.
            frames: the same key frames; the same holds.
            lattice: nodes to label; a label not below the number of genera is empty space.
        """
        ...


class Copy:
    """The true first frame for all others: what a method must beat."""

    name, failed = "copy", 0

    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """See `Method`."""
        del sample
        first = on_lattice(frames[0].label_grid, lattice).astype(np.int64)
        return [(first, frames[0].genus)] * (len(frames) - 1)


class Model:
    """The model itself: masks and genera as it predicts them."""

    name, failed = "doughnet", 0

    def __init__(self, model: DoughNet) -> None:
        self.model = model

    @torch.inference_mode()
    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """See `Method`."""
        del frames
        first = self.model.encode(sample["points"][:1], sample["point_labels"][:1])
        steps = self.model.rollout(first, sample["tool_points"][None])[0]
        return [self.model.decode(z_TD, lattice).components() for z_TD in steps]


class Vpm(Model):
    """Its volume alone: components and genera are read from it afterwards, by distance."""

    name = "vpm"

    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """See `Method`."""
        found = super().sequence(sample, frames, lattice)
        return [static_components(np.asarray(labels < len(genus))) for labels, genus in found]


def evaluate_method(
    method: Method,
    dataset: DoughSequences,
    *,
    lattice: Lattice | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Rows `full_sequence` and `final` of a method, in percent, with 95 % intervals over scenes.

    `fps` counts predicted key frames a second of this process, geometry and topology, one scene
    after the other.
    """
    lattice = lattice or workspace_lattice()
    scenes: list[list[Scored]] = []
    seconds, predicted = 0.0, 0
    for index in range(len(dataset)):
        sample = dataset[index]
        frames = [
            dataset.source.frame(scene=int(scene), frame=int(frame))
            for scene, frame in zip(sample["scene_index"], sample["frame_index"], strict=True)
        ]
        start = time.perf_counter()
        found = method.sequence(sample, frames, lattice)
        seconds += time.perf_counter() - start
        predicted += len(found)
        scenes.append(
            [
                _scored(labels, genus, frame, lattice)
                for (labels, genus), frame in zip(found, frames[1:], strict=True)
            ]
        )
        if progress is not None:
            progress(index + 1, len(dataset))
    finals = [[own[-1]] for own in scenes if own]
    return {
        "method": method.name,
        "scenes": len(dataset),
        "full_sequence": _row(scenes),
        "final": _row(finals),
        "fps": round(predicted / seconds, 2) if seconds else 0.0,
        "failed": method.failed,
    }


def _scored(labels: Any, genus: Sequence[int], frame: Frame, lattice: Lattice) -> Scored:
    truth = Truth.of_frame(frame, lattice)
    score = score_frame(labels, genus, truth, lattice)
    return Scored(score=score, topology=truth.topology)


def _row(scenes: Sequence[Sequence[Scored]]) -> dict[str, Any]:
    def mean(chosen: Sequence[Sequence[Scored]]) -> Row:
        return summary([one for own in chosen for one in own])

    return {**mean(scenes), "interval": bootstrap(scenes, mean)}
