"""The folded decoder at the nodes of a lattice, where features need not be computed node by node.

Every Fourier feature belongs to one axis. So what the latents are asked is a sum of three rows, one
from a table an axis; and the norm's square, a quadratic form, is a sum over pairs of axes. A node
costs three look-ups, one softmax over the latents and one small product.

Legend: X Y Z nodes along an axis, T tokens, F features and the 1, K components.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from doughnet.attention import EPSILON
from doughnet.folded import FoldedDecoder
from doughnet.lattice import Lattice

__all__ = ["NodeDecoder"]


class NodeDecoder:
    """Logits of the masks at nodes of one lattice, for one shape."""

    def __init__(self, folded: FoldedDecoder, lattice: Lattice, *, shape: int = 0) -> None:
        fourier = folded.decoder.fourier
        kind, device = folded.ask.dtype, folded.ask.device
        groups = [torch.tensor(group, device=device) for group in _groups(fourier.octaves)]
        features = []
        for axis, group in enumerate(groups):
            places = lattice.along(axis).to(device, kind)
            every = fourier(places[None, :, None].expand(1, -1, 3))[0]
            every = torch.cat([every, torch.ones_like(every[:, :1])], dim=1)
            features.append(every[:, group].double())
        ask = folded.ask[shape].double()
        self._ask = [(f @ ask[:, g].T).to(kind) for f, g in zip(features, groups, strict=True)]
        self._offset = folded.ask_offset[shape]
        # The weights sum to one, so the offset may be part of what they weigh.
        self._answer = folded.answer[shape] + folded.answer_offset[shape]
        self._square = [t.to(kind) for t in _pair_tables(features, groups, folded.metric.double())]

    def __call__(
        self, x: Int[Tensor, "*nodes"], y: Int[Tensor, "*nodes"], z: Int[Tensor, "*nodes"]
    ) -> Float[Tensor, "*nodes K_plus_1"]:
        """Logits at nodes by their indices along the axes, which are broadcast."""
        xy, xz, yz = self._square
        square = _at(xy, x, y) + _at(xz, x, z) + _at(yz, y, z)
        asked = _rows(self._ask[0], x) + (_rows(self._ask[1], y) + _rows(self._ask[2], z))
        scale = torch.rsqrt_(square.add_(EPSILON))[..., None]
        weights = torch.softmax(torch.addcmul(self._offset, asked, scale, out=asked), dim=-1)
        return weights @ self._answer


def _rows(
    table: Float[Tensor, "nodes T"], index: Int[Tensor, "*nodes"]
) -> Float[Tensor, "*nodes T"]:
    return table.index_select(0, index.flatten()).unflatten(0, index.shape)


def _at(
    table: Float[Tensor, "rows columns"], row: Int[Tensor, "*nodes"], column: Int[Tensor, "*nodes"]
) -> Float[Tensor, "*nodes"]:
    return table.take(row * table.shape[1] + column)


def _groups(octaves: int) -> list[list[int]]:
    """Features that depend on x, y and z; the 1 goes with x."""
    found = []
    for axis in range(3):
        waves = [axis * octaves + k for k in range(octaves)]
        found.append([*waves, *(3 * octaves + w for w in waves), 6 * octaves + axis])
    found[0].append(6 * octaves + 3)
    return found


def _pair_tables(
    features: list[Tensor], groups: list[Tensor], metric: Float[Tensor, "F F"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Tables (X, Y), (X, Z) and (Y, Z) whose sum is the mean square of a node's embedding."""

    def part(a: int, b: int) -> Tensor:
        return features[a] @ metric[groups[a]][:, groups[b]]

    own = [(part(axis, axis) * features[axis]).sum(dim=1) for axis in range(3)]
    xy, xz, yz = (2 * part(a, b) @ features[b].T for a, b in ((0, 1), (0, 2), (1, 2)))
    return xy + own[0][:, None] + own[1][None], xz + own[2][None], yz
