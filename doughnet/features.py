"""Fourier features of points: what lets a linear layer tell positions a millimetre apart."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from doughnet.config import ModelConfig

__all__ = ["FourierFeatures", "embedding"]

FALL = 1.5  # octaves over which the first weights of a frequency halve


class FourierFeatures(nn.Module):
    """sin and cos of 2^f pi x for each axis, and x itself (3DShape2VecSet, section 4.1).

    `size` is the number of features a point: 6 a frequency, and 3.
    """

    frequencies: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.scale = config.scale
        self.octaves, self.size = config.frequencies, 6 * config.frequencies + 3
        powers = math.pi * 2.0 ** torch.arange(config.frequencies)
        self.register_buffer("frequencies", powers, persistent=False)

    def forward(self, points: Float[Tensor, "B N 3"]) -> Float[Tensor, "B N features"]:
        """Features of points [m], world."""
        x = points / self.scale
        phase = (x[..., None] * self.frequencies).flatten(-2)
        return torch.cat([phase.sin(), phase.cos(), x], dim=-1)


def embedding(fourier: FourierFeatures, width: int) -> nn.Linear:
    """A linear layer on Fourier features that starts smooth: fine detail has small weights.

    With equal weights, seven of eight features tell only where a point lies within a centimetre,
    and shapes are learned later (`LOG.md`). The layer can learn any weights.
    """
    layer = nn.Linear(fourier.size, width)
    octaves = torch.arange(len(fourier.frequencies))
    share = torch.cat([(2.0 ** (-octaves / FALL)).repeat(6), torch.ones(3)])
    with torch.no_grad():
        layer.weight.mul_(share / share.square().mean().sqrt())
    return layer
