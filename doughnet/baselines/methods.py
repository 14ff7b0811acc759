"""One table for all ways to predict a sequence from its first view and the tool's motion."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Int, Integer
from torch import Tensor

from doughdata.dataset import Frame
from doughdata.torch import DoughSequences
from doughnet.baselines.occupancy import static_components
from doughnet.evaluate import Timer, Truth, scored
from doughnet.lattice import Lattice, on_lattice, workspace_lattice
from doughnet.model import DoughNet
from doughnet.tables import Scored, table_row, with_steps

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
    """Rows `full_sequence` and `final` of a method and its `fps`, as `evaluate` gives them."""
    lattice = lattice or workspace_lattice()
    scenes: list[list[Scored]] = []
    timer = Timer()
    for index in range(len(dataset)):
        sample = dataset[index]
        frames = [
            dataset.source.frame(scene=int(scene), frame=int(frame))
            for scene, frame in zip(sample["scene_index"], sample["frame_index"], strict=True)
        ]
        with timer:
            found = method.sequence(sample, frames, lattice)
        timer.count += len(found)
        scenes.append(
            [
                scored(labels, genus, Truth.of_frame(frame, lattice), lattice)
                for (labels, genus), frame in zip(found, frames[1:], strict=True)
            ]
        )
        if progress is not None:
            progress(index + 1, len(dataset))
    return {
        "method": method.name,
        "scenes": len(dataset),
        "full_sequence": with_steps(scenes),
        "final": table_row([own[-1:] for own in scenes]),
        "fps": timer.per_second,
        "failed": method.failed,
    }
