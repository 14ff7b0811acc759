"""The denoising autoencoder: a partial, noisy point cloud becomes a set of latent codes, and these
become component masks anywhere in space and a genus for every component (DoughNet, section 3).

Legend: B batch, N points, S queries, T = latents + 1 tokens, D width, K components.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from doughnet.attention import Attention, Block, norm, repeat_batch
from doughnet.config import ModelConfig
from doughnet.features import FourierFeatures, embedding

__all__ = ["Autoencoder", "Decoder", "Encoder", "input_labels"]

SHARPER = 2.0  # first weights of the decoder's attention, over the usual ones
QUERY_SPREAD = 1.0  # standard deviation of learned queries at the start


def input_labels(labels: Int[Tensor, "*batch"], *, components: int) -> Int[Tensor, "*batch"]:
    """Label of a point as the encoder reads it: 0 = none, component k = k + 1.

    Padding and components beyond the K-th have none.
    """
    return torch.where((labels >= 0) & (labels < components), labels + 1, 0)


class Encoder(nn.Module):
    """Labelled points -> a set of latent codes of unit length (as root mean square).

    Learned queries gather from the points by cross-attention, their mean is appended as a token of
    its own, and self-attention denoises and completes.
    """

    def __init__(self, config: ModelConfig, *, depth: int) -> None:
        super().__init__()
        self.labels = config.input_labels
        self.fourier = FourierFeatures(config)
        self.embed = embedding(self.fourier, config.width - self.labels)
        self.queries = nn.Parameter(QUERY_SPREAD * torch.randn(config.latents, config.width))
        self.gather = Block(config, context_width=config.width)
        self.blocks = nn.ModuleList(Block(config) for _ in range(depth))
        self.norm = norm(config.width, config, affine=False)

    def forward(
        self, points: Float[Tensor, "B N 3"], labels: Int[Tensor, "B N"]
    ) -> Float[Tensor, "B T D"]:
        """Latent codes of points [m]; `labels` as `input_labels` gives them."""
        one_hot = functional.one_hot(labels, self.labels).to(points.dtype)
        features = torch.cat([self.embed(self.fourier(points)), one_hot], dim=-1)
        z_BTD = self.gather(repeat_batch(self.queries, len(points)), features)
        z_BTD = torch.cat([z_BTD, z_BTD.mean(dim=1, keepdim=True)], dim=1)
        for block in self.blocks:
            z_BTD = block(z_BTD)
        return self.norm(z_BTD)


class Decoder(nn.Module):
    """Latent codes -> K + 1 masks at any point, and the genus of each component.

    A point asks the latents through one head without feed-forward, so that the masks are linear in
    its Fourier features but for one norm and one softmax: `folded.py` relies on it.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.components, self.width = config.components, config.width
        self.fourier = FourierFeatures(config)
        self.embed = embedding(self.fourier, config.width)
        self.point_norm = norm(config.width, config)
        self.latent_norm = norm(config.width, config)
        self.interpolate = Attention(config.width, context_width=config.width, heads=1)
        with torch.no_grad():  # one head over all latents starts near their plain mean
            self.interpolate.query.weight.mul_(SHARPER)
            self.interpolate.key.weight.mul_(SHARPER)
        # K component queries, then the one of the outliers.
        self.queries = nn.Parameter(QUERY_SPREAD * torch.randn(config.components + 1, config.width))
        self.gather = Block(config, context_width=config.width)
        self.compare = Block(config)
        self.component_norm = norm(config.width, config)
        self.mask = nn.Linear(config.width, config.width)
        self.genus = nn.Sequential(
            nn.Linear(config.width, config.width),
            nn.GELU(),
            nn.Linear(config.width, config.genus_classes),
        )

    def components_of(
        self, z_BTD: Float[Tensor, "B T D"]
    ) -> tuple[Float[Tensor, "B K_plus_1 D"], Float[Tensor, "B K classes"]]:
        """What each mask looks for, and the logits of each component's genus."""
        found = self.gather(repeat_batch(self.queries, len(z_BTD)), z_BTD)
        found = self.component_norm(self.compare(found))
        return self.mask(found), self.genus(found[:, : self.components])

    def forward(
        self, z_BTD: Float[Tensor, "B T D"], points: Float[Tensor, "B S 3"]
    ) -> tuple[Float[Tensor, "B S K_plus_1"], Float[Tensor, "B K classes"]]:
        """Logits of the masks at points [m], the outliers last, and of the genus classes."""
        masks, genus = self.components_of(z_BTD)
        asked = self.point_norm(self.embed(self.fourier(points)))
        local = self.interpolate(asked, self.latent_norm(z_BTD))
        return local @ masks.transpose(1, 2) / math.sqrt(self.width), genus


class Autoencoder(nn.Module):
    """Encoder and decoder of one shape."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.encoder = Encoder(config, depth=config.encoder_depth)
        self.decoder = Decoder(config)

    def forward(
        self,
        points: Float[Tensor, "B N 3"],
        labels: Int[Tensor, "B N"],
        queries: Float[Tensor, "B S 3"],
    ) -> tuple[Float[Tensor, "B S K_plus_1"], Float[Tensor, "B K classes"]]:
        """Masks at `queries` [m] and genus logits of what `points` [m] show."""
        return self.decoder(self.encoder(points, labels), queries)
