"""A graph network over few particles: the learned particle dynamics that the paper compares with.

After RoboCook (Shi et al. 2023): 300 particles, a history of four key frames, features of width
150; nodes are particles and points of the tool, edges join what is near, messages are passed a few
times with the same weights, and every particle's motion to the next key frame is read off its node.

Legend: B batch, H history, N particles, T tool points, E edges.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

__all__ = ["ParticleConfig", "ParticleNet"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleConfig:
    """Sizes of the network; lengths in spacings of its particles."""

    particles: int = 300
    history: int = 4  # key frames up to the present one
    tool_points: int = 64  # a finger
    width: int = 150
    rounds: int = 3  # of messages
    reach: float = 2.2  # between the ends of an edge


class ParticleNet(nn.Module):
    """Predicts particles of the next key frame from those of the last ones and the tool's motion.

    Everything is seen in spacings and relative to each other, but for the height above the table:
    turning or moving a scene over the table turns or moves what comes out, the former up to what
    training taught.
    """

    def __init__(self, config: ParticleConfig) -> None:
        super().__init__()
        self.config = config
        width, past = config.width, 3 * (config.history - 1)
        self.node = _mlp(past + 3 + 2, width)  # velocities, the tool's step, height, kind
        self.edge = _mlp(3 + 1 + 2, width)  # the way, its length, both kinds
        self.message = _mlp(3 * width, width)
        self.update = _mlp(2 * width, width)
        self.read = _mlp(width, width)
        self.motion = nn.Linear(width, 3)
        nn.init.zeros_(self.motion.weight)  # at first everything stays where it is
        nn.init.zeros_(self.motion.bias)

    def forward(
        self,
        history: Float[Tensor, "B H N 3"],
        tool: Float[Tensor, "B 2 T 3"],
        spacing: Float[Tensor, " B"],
    ) -> Float[Tensor, "B N 3"]:
        """Particles of the next key frame [m].

        Args:
            history: particles of the last key frames, the present one last [m].
            tool: points of all fingers at the present and the next key frame [m].
            spacing: of the particles [m].
        """
        unit = spacing[:, None, None]
        now = history[:, -1]
        place = torch.cat([now, tool[:, 0]], dim=1) / unit  # (B, N + T, 3)
        features, kind = self._nodes(history, tool, unit)
        sender, receiver = _near(place, kind, self.config.reach)
        flat = place.flatten(0, 1)
        way = flat[sender] - flat[receiver]
        kinds = kind.flatten()
        ends = torch.stack([kinds[sender], kinds[receiver]], dim=1).to(way.dtype)
        edges = self.edge(torch.cat([way, way.norm(dim=1, keepdim=True), ends], dim=1))
        nodes = self.node(features.flatten(0, 1))
        for _ in range(self.config.rounds):
            sent = self.message(torch.cat([edges, nodes[sender], nodes[receiver]], dim=1))
            heard = torch.zeros_like(nodes).index_add(0, receiver, sent)
            nodes = nodes + self.update(torch.cat([nodes, heard], dim=1))
        nodes = nodes.reshape(*place.shape[:2], -1)[:, : now.shape[1]]
        return now + unit * self.motion(self.read(nodes))

    def _nodes(
        self,
        history: Float[Tensor, "B H N 3"],
        tool: Float[Tensor, "B 2 T 3"],
        unit: Float[Tensor, "B 1 1"],
    ) -> tuple[Float[Tensor, "B nodes features"], Bool[Tensor, "B nodes"]]:
        """Features of all nodes, and which are of the tool."""
        batch, _, count, _ = history.shape
        points = tool.shape[2]
        velocity = (history[:, 1:] - history[:, :-1]).permute(0, 2, 1, 3).flatten(2) / unit
        step = (tool[:, 1] - tool[:, 0]) / unit
        own = torch.cat([velocity, torch.zeros_like(history[:, -1])], dim=2)
        still = velocity.new_zeros(batch, points, velocity.shape[2])
        other = torch.cat([still, step], dim=2)
        height = torch.cat([history[:, -1, :, 2:], tool[:, 0, :, 2:]], dim=1) / unit
        kind = torch.arange(count + points, device=history.device) >= count
        kind = kind.expand(batch, -1)
        moving = torch.cat([own, other], dim=1)
        features = [moving, height.clamp(max=3.0), kind[..., None].to(height.dtype)]
        return torch.cat(features, dim=2), kind


def _mlp(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.LayerNorm(width)
    )


def _near(
    place: Float[Tensor, "B nodes 3"], kind: Bool[Tensor, "B nodes"], reach: float
) -> tuple[Int[Tensor, " E"], Int[Tensor, " E"]]:
    """Sender and receiver of every edge: nearer than `reach`, received by a particle."""
    with torch.no_grad():
        close = torch.cdist(place, place) < reach
        close &= ~torch.eye(place.shape[1], dtype=torch.bool, device=place.device)
        close &= ~kind[:, :, None]  # the tool hears nobody
        batch, receiver, sender = torch.nonzero(close, as_tuple=True)
        first = batch * place.shape[1]
    return first + sender, first + receiver
