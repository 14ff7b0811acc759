"""The dynamics model: latent codes of the dough and the tool's motion -> the next latent codes.

Legend: B batch, P tool points, T tokens, D width.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from doughnet.attention import Block, norm
from doughnet.autoencoder import Encoder
from doughnet.config import ModelConfig

__all__ = ["Dynamics"]


class _Stack(nn.Module):
    """Two self-attention blocks, then one that looks at the tool."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.first, self.second = Block(config), Block(config)
        self.tool = Block(config, context_width=2 * config.width)
        for block in (self.first, self.second, self.tool):
            block.start_as_identity()

    def forward(
        self, z_BTD: Float[Tensor, "B T D"], action: Float[Tensor, "B T 2*D"]
    ) -> Float[Tensor, "B T D"]:
        return self.tool(self.second(self.first(z_BTD)), action)


class Dynamics(nn.Module):
    """Predicts the next set of latent codes outright, not its difference from the last one.

    With `relative` it predicts the difference, to compare. Before it has learned anything it copies
    its input.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.manipulator = Encoder(config, depth=config.manipulator_depth)
        self.stacks = nn.ModuleList(_Stack(config) for _ in range(config.dynamics_stacks))
        self.norm = norm(config.width, config, affine=False)
        self.change = nn.Linear(config.width, config.width) if config.relative else None
        if self.change is not None:
            nn.init.zeros_(self.change.weight)
            nn.init.zeros_(self.change.bias)

    def embed_tool(self, tool_points: Float[Tensor, "B P 3"]) -> Float[Tensor, "B T D"]:
        """Latent codes of points [m] on the tool's surface at one instant; their label is 0."""
        labels = torch.zeros(tool_points.shape[:2], dtype=torch.int64, device=tool_points.device)
        return self.manipulator(tool_points, labels)

    def forward(
        self,
        z_BTD: Float[Tensor, "B T D"],
        tool: Float[Tensor, "B T D"],
        next_tool: Float[Tensor, "B T D"],
    ) -> Float[Tensor, "B T D"]:
        """Latents one step on, given those of the tool now and then (from `embed_tool`)."""
        action, before = torch.cat([tool, next_tool], dim=-1), z_BTD
        for stack in self.stacks:
            z_BTD = stack(z_BTD, action)
        if self.change is not None:
            z_BTD = before + self.change(self.norm(z_BTD))
        return self.norm(z_BTD)
