"""The two stages of training: first the autoencoder alone, then the dynamics on its frozen codes.

A stage is a module whose `forward(batch)` gives the losses of a batch. A batch is a dictionary as
`doughdata.torch` serves it; a dynamics batch has a second axis of frames.
"""

from typing import Any, Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from doughnet.augment import Augmentation, augmented
from doughnet.config import ModelConfig
from doughnet.folded import fold
from doughnet.losses import IGNORED, latent_loss, shape_loss
from doughnet.model import DoughNet

__all__ = [
    "AutoencoderStage",
    "Batch",
    "DynamicsStage",
    "Losses",
    "Stage",
    "genus_classes",
    "query_classes",
]

MATCH_EVERY = 4  # one query in so many suffices to tell which mask is which component
Batch = dict[str, Tensor]
Losses = dict[str, Tensor]


class Stage(Protocol):
    """What the training loop needs to know."""

    name: str
    model: Any  # a module that was made from its `config`, a dataclass

    def __call__(self, batch: Batch, *, seed: int) -> Losses:
        """Losses of a batch; `loss` is minimised, the others are logged."""
        ...


def query_classes(
    labels: Int[Tensor, "*batch S"], num_components: Int[Tensor, "*batch"], *, components: int
) -> Int[Tensor, "*batch S"]:
    """Target mask of each query: K for empty space, IGNORED for components that have no mask."""
    empty = labels >= num_components[..., None]
    beyond = (labels >= components) & ~empty
    return torch.where(beyond, IGNORED, torch.where(empty, components, labels))


def genus_classes(
    genus: Int[Tensor, "*batch most"], config: ModelConfig
) -> Int[Tensor, "*batch K"]:
    """Target class of each component from its genus, which is padded with -1."""
    short = config.components - genus.shape[-1]
    if short > 0:
        genus = nn.functional.pad(genus, (0, short), value=-1)
    genus = genus[..., : config.components]
    return torch.where(genus < 0, config.empty_class, genus.clamp(max=config.max_genus))


class AutoencoderStage(nn.Module):
    """Complete and segment single views; the dynamics model is not touched."""

    name = "autoencoder"
    class_weights: Tensor | None

    def __init__(
        self,
        model: DoughNet,
        *,
        genus_weight: float = 0.1,
        class_weights: Float[Tensor, " classes"] | None = None,
        augmentation: Augmentation | None = None,
    ) -> None:
        super().__init__()
        self.model, self.genus_weight = model, genus_weight
        self.augmentation = augmentation or Augmentation()
        self.register_buffer("class_weights", class_weights, persistent=False)
        model.dynamics.requires_grad_(False)
        model.autoencoder.requires_grad_(True)

    def forward(self, batch: Batch, *, seed: int) -> Losses:
        """Losses of a batch of views."""
        config = self.model.config
        batch = augmented(batch, self.augmentation, seed=seed, components=config.components)
        latents = self.model.encode(batch["points"], batch["point_labels"])
        folded = fold(self.model.autoencoder.decoder, latents)  # the same masks at half the cost
        labels = query_classes(
            batch["query_labels"], batch["num_components"], components=config.components
        )
        loss = shape_loss(
            folded(batch["queries"]),
            labels,
            folded.genus,
            genus_classes(batch["genus"], config),
            genus_weights=self.class_weights,
        )
        total = loss.masks + self.genus_weight * loss.genus
        return {"loss": total, "masks": loss.masks, "genus": loss.genus}


class DynamicsStage(nn.Module):
    """Predict latents two steps on, the second from the model's own first prediction.

    What is compared are the latents; with `explicit` the shapes that the frozen decoder makes of
    them, to compare.

    The autoencoder is frozen but for the last layers of the genus head, which learn from encoded
    and predicted latents alike. They come after the masks, so these stay what they were.
    """

    name = "dynamics"
    class_weights: Tensor | None

    def __init__(
        self,
        model: DoughNet,
        *,
        genus_weight: float = 0.1,
        class_weights: Float[Tensor, " classes"] | None = None,
        augmentation: Augmentation | None = None,
        explicit: bool = False,
    ) -> None:
        super().__init__()
        self.model, self.genus_weight = model, genus_weight
        self.explicit = explicit
        self.augmentation = augmentation or Augmentation(label_dropout=0.0)
        self.register_buffer("class_weights", class_weights, persistent=False)
        model.autoencoder.requires_grad_(False)
        model.autoencoder.decoder.genus.requires_grad_(True)
        model.dynamics.requires_grad_(True)

    def forward(self, batch: Batch, *, seed: int) -> Losses:
        """Losses of a batch of consecutive frames, (B, frames, ...)."""
        config = self.model.config
        batch = augmented(batch, self.augmentation, seed=seed, components=config.components)
        frames = batch["points"].shape[:2]
        with torch.no_grad():
            true = self.model.encode(
                batch["points"].flatten(0, 1), batch["point_labels"].flatten(0, 1)
            ).unflatten(0, frames)
        predicted = self.model.rollout(true[:, 0], batch["tool_points"])
        if self.explicit:
            return self._explicit(batch, predicted)
        # A frame in which the tool hides all dough tells nothing.
        seen = (batch["point_labels"] >= 0).any(dim=2)
        latent = latent_loss(predicted, true[:, 1:], seen=seen[:, 1:] & seen[:, :1])
        genus = self._genus(batch, torch.cat([true[:, 1:], predicted], dim=0))
        return {"loss": latent + self.genus_weight * genus, "latent": latent, "genus": genus}

    def _explicit(self, batch: Batch, latents: Float[Tensor, "B steps T D"]) -> Losses:
        """Losses of the shapes that are decoded from predicted latents."""
        config = self.model.config
        labels = query_classes(
            batch["query_labels"], batch["num_components"], components=config.components
        )[:, 1:]
        folded = fold(self.model.autoencoder.decoder, latents.flatten(0, 1))
        loss = shape_loss(
            folded(batch["queries"][:, 1:].flatten(0, 1)),
            labels.flatten(0, 1),
            folded.genus,
            genus_classes(batch["genus"], config)[:, 1:].flatten(0, 1),
            genus_weights=self.class_weights,
        )
        total = loss.masks + self.genus_weight * loss.genus
        return {"loss": total, "masks": loss.masks, "genus": loss.genus}

    def _genus(self, batch: Batch, latents: Float[Tensor, "B2 steps T D"]) -> Tensor:
        """Cross-entropy of the genus head on given latents, which it does not change."""
        config, decoder = self.model.config, self.model.autoencoder.decoder
        some = slice(None, None, MATCH_EVERY)  # of both kinds of queries, which stand in a row
        queries = batch["queries"][:, 1:, some].repeat(2, 1, 1, 1).flatten(0, 1)
        labels = query_classes(
            batch["query_labels"], batch["num_components"], components=config.components
        )[:, 1:, some]
        classes = genus_classes(batch["genus"], config)[:, 1:]
        folded = fold(decoder, latents.flatten(0, 1).detach())
        with torch.no_grad():
            logits = folded(queries)
        return shape_loss(
            logits,
            labels.repeat(2, 1, 1).flatten(0, 1),
            folded.genus,
            classes.repeat(2, 1, 1).flatten(0, 1),
            genus_weights=self.class_weights,
        ).genus
