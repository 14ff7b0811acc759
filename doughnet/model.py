"""DoughNet whole: encode what is seen, predict in latent space, decode what is wanted."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, Int8, UInt8
from torch import Tensor, nn

from doughnet.autoencoder import Autoencoder, input_labels
from doughnet.config import ModelConfig
from doughnet.dynamics import Dynamics
from doughnet.folded import fold
from doughnet.hierarchical import decode_labels
from doughnet.lattice import Lattice, workspace_lattice
from doughnet.metrics import UNASSIGNED
from doughnet.nodes import NodeDecoder

__all__ = ["DoughNet", "Shape"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """What the model says of one frame."""

    labels: UInt8[Tensor, "nx ny nz"]  # mask at every node; K is empty space
    genus: tuple[int | None, ...]  # of every mask; None = the head calls it empty

    @property
    def consistent(self) -> bool:
        """Whether the masks that occur are those that the genus head does not call empty."""
        found = [bool((self.labels == k).any()) for k in range(len(self.genus))]
        return found == [genus is not None for genus in self.genus]

    def components(self) -> tuple[Int8[Tensor, "nx ny nz"], list[int]]:
        """Labels and genera of the components that the genus head sees, renumbered from 0.

        Dough in a mask that the head calls empty is `UNASSIGNED`; empty space has a label past the
        last component.
        """
        genus = [g for g in self.genus if g is not None]
        found = torch.full_like(self.labels, len(genus), dtype=torch.int8)
        names = iter(range(len(genus)))
        for mask, of_mask in enumerate(self.genus):
            name = UNASSIGNED if of_mask is None else next(names)
            found.masked_fill_(self.labels == mask, name)
        return found, genus


class DoughNet(nn.Module):
    """Autoencoder and dynamics model of one config."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.autoencoder = Autoencoder(config)
        self.dynamics = Dynamics(config)

    def encode(
        self, points: Float[Tensor, "B N 3"], labels: Int[Tensor, "B N"]
    ) -> Float[Tensor, "B T D"]:
        """Latents of points [m] with their components, a negative label being none."""
        known = input_labels(labels, components=self.config.components)
        return self.autoencoder.encoder(points, known)

    def rollout(
        self, z_BTD: Float[Tensor, "B T D"], tool_points: Float[Tensor, "B frames fingers P 3"]
    ) -> Float[Tensor, "B steps T D"]:
        """Latents of all later frames, each from the one before, given the tool in every frame."""
        batch, frames = tool_points.shape[:2]
        points = tool_points.flatten(2, 3).flatten(0, 1)
        tools = self.dynamics.embed_tool(points).unflatten(0, (batch, frames))
        steps = []
        for k in range(frames - 1):
            z_BTD = self.dynamics(z_BTD, tools[:, k], tools[:, k + 1])
            steps.append(z_BTD)
        return torch.stack(steps, dim=1)

    @torch.inference_mode()
    def decode(self, z_TD: Float[Tensor, "T D"], lattice: Lattice | None = None) -> Shape:
        """Labels and genera of one set of latents, on the whole workspace by default."""
        folded = fold(self.autoencoder.decoder, z_TD[None])
        labels = decode_labels(
            lambda whole: NodeDecoder(folded, whole), lattice or workspace_lattice()
        )
        classes = folded.genus[0].argmax(dim=-1).tolist()
        empty = self.config.empty_class
        return Shape(labels=labels, genus=tuple(None if c == empty else c for c in classes))
