"""The simulator as the model of what happens: it starts from what the first view was taken for."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from doughdata.dataset import Frame
from doughnet.baselines.methods import Found
from doughnet.lattice import Lattice, on_lattice
from doughnet.model import DoughNet, Shape
from doughschemas import DoughError, LabelGrid

__all__ = ["Player", "Simulated"]


class Player(Protocol):
    """Simulation, topology check and mesher, as one."""

    def play(
        self, shape: Shape, frames: Sequence[Frame]
    ) -> Sequence[tuple[LabelGrid, Sequence[int]]]:
        """Labels and genera of all key frames but the first, from a shape in the first.

        Raises:
            DoughError: the shape cannot be simulated, or its simulation failed.
        """
        ...


class Simulated:
    """The first view's reconstruction, simulated under the known motion of the tool.

    Where that fails, the reconstruction stays for all later frames; `failed` counts such scenes.
    """

    name = "mpm"

    def __init__(self, model: DoughNet, player: Player) -> None:
        self.model, self.player = model, player
        self.failed = 0

    @torch.inference_mode()
    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """See `Method`."""
        first = self.model.encode(sample["points"][:1], sample["point_labels"][:1])
        shape = self.model.decode(first[0])
        try:
            played = self.player.play(shape, frames)
        except DoughError:
            self.failed += 1
            return [self.model.decode(first[0], lattice).components()] * (len(frames) - 1)
        return [(on_lattice(grid, lattice).astype(np.int64), genus) for grid, genus in played]
