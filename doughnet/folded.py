"""The decoder folded for one shape: the same masks, five to twenty times sooner.

A point's features f (with a 1 appended) reach the masks through `embed`, a norm, one head of
attention and a dot product. All but norm and softmax are linear, so that for given latents they
shrink to two small matrices: logits(f) = softmax(f A^T / r(f) + a) B + b. The norm's root mean
square is a quadratic form too: r(f)^2 = f G f^T + epsilon. Nothing is approximated; only the order
of rounding differs.

Legend: B batch, S queries, T tokens, F features and the 1, K components.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from doughnet.attention import EPSILON
from doughnet.autoencoder import Decoder

__all__ = ["FoldedDecoder", "fold"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FoldedDecoder:
    """Masks of given latents, and the genus logits that came with them."""

    decoder: Decoder
    ask: Float[Tensor, "B T F"]  # A
    ask_offset: Float[Tensor, "B 1 T"]  # a
    answer: Float[Tensor, "B T K_plus_1"]  # B
    answer_offset: Float[Tensor, "B 1 K_plus_1"]  # b
    metric: Float[Tensor, "F F"]  # G
    genus: Float[Tensor, "B K classes"]

    def __call__(self, points: Float[Tensor, "B S 3"]) -> Float[Tensor, "B S K_plus_1"]:
        """Logits of the masks at points [m], the outliers last."""
        # Fine detail is small differences of large numbers: no half precision here.
        with torch.autocast(points.device.type, enabled=False):
            features = self.decoder.fourier(points)
            features = torch.cat([features, torch.ones_like(features[..., :1])], dim=-1)
            square = ((features @ self.metric) * features).sum(dim=-1, keepdim=True)
            features = features * torch.rsqrt(square + EPSILON)
            weights = torch.softmax(features @ self.ask.transpose(1, 2) + self.ask_offset, dim=-1)
            return weights @ self.answer + self.answer_offset


def fold(decoder: Decoder, z_BTD: Float[Tensor, "B T D"]) -> FoldedDecoder:
    """Fold a decoder over latents; differentiable in both."""
    masks, genus = decoder.components_of(z_BTD)
    attention, point_norm, kind = (
        decoder.interpolate,
        decoder.point_norm,
        decoder.embed.weight.dtype,
    )
    # The products are few and are taken in double precision: what is left is the rounding of the
    # plain decoder itself. Weights meet weights first, so that no product is latents x D x D.
    embed = torch.cat([decoder.embed.weight, decoder.embed.bias[:, None]], dim=1).double()  # D F
    offset = torch.zeros(decoder.width, 1, dtype=torch.float64, device=z_BTD.device)
    if isinstance(point_norm, nn.LayerNorm):
        embed = embed - embed.mean(dim=0, keepdim=True)  # a layer norm takes the mean away first
        offset = point_norm.bias.double()[:, None]
    scale = point_norm.get_parameter("weight").double()[:, None]
    asked = torch.cat([scale * embed, offset], dim=1)  # D F+1
    share = masks.double().transpose(1, 2)  # B D K+1
    with torch.autocast(z_BTD.device.type, enabled=False):
        latents = decoder.latent_norm(z_BTD).double()
        query, key = attention.query.weight.double(), attention.key.weight.double()
        value, out = attention.value.weight.double(), attention.out
        ask = latents @ (key.T @ (query @ asked)) / math.sqrt(decoder.width)  # B T F+1
        answer = latents @ (value.T @ (out.weight.double().T @ share)) / math.sqrt(decoder.width)
        answer_offset = (out.bias.double() @ share)[:, None] / math.sqrt(decoder.width)
        metric = embed.T @ embed / decoder.width
    return FoldedDecoder(
        decoder=decoder,
        ask=ask[..., :-1].to(kind),
        ask_offset=ask[..., -1][:, None].to(kind),
        answer=answer.to(kind),
        answer_offset=answer_offset.to(kind),
        metric=metric.to(kind),
        genus=genus,
    )
