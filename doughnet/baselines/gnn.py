"""The graph network as a method: particles in the first reconstruction, moved step by step."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from doughdata.dataset import Frame
from doughnet.baselines.methods import Found
from doughnet.baselines.occupancy import static_components
from doughnet.baselines.particle_data import finger_points, spacing_of, spread
from doughnet.baselines.particle_net import ParticleConfig, ParticleNet
from doughnet.baselines.particle_stage import ParticleStage
from doughnet.lattice import Lattice, on_lattice
from doughnet.model import DoughNet
from doughnet.weights import read_weights
from doughschemas import NO_COMPONENT, BadInputError, LabelGrid

__all__ = ["Gnn", "Surface", "load_particle_net"]

Surface = Callable[[Float32[np.ndarray, "particles 3"], float], LabelGrid]
SEED = 0


class Gnn:
    """Predicts few particles and puts a surface around them; components come from distances.

    Where the model sees no dough, or the network's numbers overflow, the later key frames are
    empty; `failed` counts such scenes.
    """

    name = "gnn"

    def __init__(self, model: DoughNet, net: ParticleNet, surface: Surface) -> None:
        """`surface` makes labels on a grid from particles [m] and their spacing [m]."""
        self.model, self.net, self.surface = model, net, surface
        self.failed = 0

    @torch.inference_mode()
    def sequence(
        self, sample: Mapping[str, Tensor], frames: Sequence[Frame], lattice: Lattice
    ) -> Sequence[Found]:
        """See `Method`."""
        first = self.model.encode(sample["points"][:1], sample["point_labels"][:1])
        labels, genus = self.model.decode(first[0], lattice).components()
        inside = torch.as_tensor(labels).reshape(-1) < len(genus)
        nodes = torch.nonzero(inside)[:, 0]
        empty: Found = (np.zeros(lattice.shape, np.int64), [])
        if not len(nodes):
            self.failed += 1
            return [empty] * (len(frames) - 1)
        count = self.net.config.particles
        spacing = spacing_of(len(nodes) * lattice.spacing**3, count)
        places = lattice.points(nodes)
        points = places[spread(places, count)]
        tool = finger_points(frames, self.net.config.tool_points, seed=SEED)
        history = points.expand(self.net.config.history, -1, -1)
        found: list[Found] = []
        for step in range(len(frames) - 1):
            after = self.net(history[None], tool[None, step : step + 2], torch.tensor([spacing]))
            if not after.isfinite().all():
                self.failed += 1
                return found + [empty] * (len(frames) - 1 - step)
            history = torch.cat([history[1:], after])
            grid = self.surface(after[0].numpy(), spacing)
            found.append(static_components(on_lattice(grid, lattice) != NO_COMPONENT))
        return found


def load_particle_net(folder: Path) -> ParticleNet:
    """The trained network in a training's folder, or beside the stage that `folder` holds.

    Raises:
        BadInputError: none was trained there, or what is there is damaged.
    """
    places = [folder / ParticleStage.name, folder.parent / ParticleStage.name]
    found = next((place for place in places if place.is_dir()), places[1])
    stored = read_weights(found, stage=ParticleStage.name)
    try:
        net = ParticleNet(ParticleConfig(**stored.config))
    except TypeError as error:
        raise BadInputError(
            f"{stored.path}: no particle network of this release: {error}"
        ) from error
    return stored.into(net)
