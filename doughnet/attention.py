"""Attention, gated feed-forward and the block that all parts of the model are built of.

Legend of shapes: B batch, N tokens that ask, M tokens that are asked, D width, C width of M.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from doughnet.config import ModelConfig

__all__ = ["Attention", "Block", "GatedFeedForward", "norm"]

EPSILON = 1e-5


def norm(width: int, config: ModelConfig, *, affine: bool = True) -> nn.Module:
    """Layer norm or RMS norm over the last axis."""
    kind = nn.LayerNorm if config.norm == "layer" else nn.RMSNorm
    return kind(width, eps=EPSILON, elementwise_affine=affine)


class Attention(nn.Module):
    """Scaled dot-product attention (Vaswani et al. 2017) of N tokens over M others."""

    def __init__(
        self, width: int, *, context_width: int, heads: int, query_key_norm: bool = False
    ) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width, bias=False)
        self.key = nn.Linear(context_width, width, bias=False)
        self.value = nn.Linear(context_width, width, bias=False)
        self.out = nn.Linear(width, width)
        head = width // heads
        self.query_norm = nn.RMSNorm(head, eps=EPSILON) if query_key_norm else nn.Identity()
        self.key_norm = nn.RMSNorm(head, eps=EPSILON) if query_key_norm else nn.Identity()

    def forward(
        self, x_BND: Float[Tensor, "B N D"], context_BMC: Float[Tensor, "B M C"]
    ) -> Float[Tensor, "B N D"]:
        """What each of N tokens takes from M others."""
        query = self.query_norm(self._split(self.query(x_BND)))
        key = self.key_norm(self._split(self.key(context_BMC)))
        value = self._split(self.value(context_BMC))
        taken = functional.scaled_dot_product_attention(query, key, value)
        return self.out(taken.transpose(1, 2).flatten(2))

    def _split(self, x_BND: Float[Tensor, "B N D"]) -> Float[Tensor, "B heads N head"]:
        return x_BND.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class GatedFeedForward(nn.Module):
    """A gated linear unit with GELU or SiLU (Shazeer 2020)."""

    def __init__(self, width: int, config: ModelConfig) -> None:
        super().__init__()
        hidden = int(width * config.expansion) // 8 * 8
        self.enter = nn.Linear(width, 2 * hidden)
        self.leave = nn.Linear(hidden, width)
        self.activation = nn.GELU() if config.gate == "gelu" else nn.SiLU()

    def forward(self, x: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch D"]:
        """Each token by itself."""
        value, gate = self.enter(x).chunk(2, dim=-1)
        return self.leave(value * self.activation(gate))


class Block(nn.Module):
    """Pre-norm attention and feed-forward, each added to its input.

    Without a `context_width` the tokens attend to each other; with it, to a context.
    """

    def __init__(self, config: ModelConfig, *, context_width: int | None = None) -> None:
        super().__init__()
        width = config.width
        self.norm = norm(width, config)
        self.context_norm = None if context_width is None else norm(context_width, config)
        self.attention = Attention(
            width,
            context_width=context_width or width,
            heads=config.heads,
            query_key_norm=config.query_key_norm,
        )
        self.feed_forward_norm = norm(width, config)
        self.feed_forward = GatedFeedForward(width, config)

    def forward(
        self, x_BND: Float[Tensor, "B N D"], context_BMC: Float[Tensor, "B M C"] | None = None
    ) -> Float[Tensor, "B N D"]:
        """New tokens from the old ones and, in a cross-attention block, from the context."""
        normed = self.norm(x_BND)
        asked = normed
        if self.context_norm is not None:
            if context_BMC is None:
                raise ValueError("a cross-attention block needs a context")
            asked = self.context_norm(context_BMC)
        x_BND = x_BND + self.attention(normed, asked)
        return x_BND + self.feed_forward(self.feed_forward_norm(x_BND))

    def start_as_identity(self) -> None:
        """Zero what is added, so that the block passes its input on until it has learned."""
        for layer in (self.attention.out, self.feed_forward.leave):
            nn.init.zeros_(layer.weight)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)


def repeat_batch(x_ND: Float[Tensor, "N D"], batch: int) -> Float[Tensor, "batch N D"]:
    """The same learned tokens for every sample."""
    return torch.broadcast_to(x_ND, (batch, *x_ND.shape))
