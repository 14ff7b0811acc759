"""Losses that do not care in which order components are named.

Focal loss of a point depends on the probability of its own class alone. So one K x K matrix holds
what it costs if mask k stands for component j, and any permutation costs a sum of K entries: 24
sums for four components, the Hungarian method (Kuhn 1955) beyond.

Legend: B batch, S queries, K components.
"""

from dataclasses import dataclass
from itertools import permutations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

__all__ = ["IGNORED", "ShapeLoss", "best_masks", "focal_costs", "latent_loss", "shape_loss"]

IGNORED = -1  # label of a query that counts for nothing
FOCUS = 2.0  # the exponent of Lin et al. (2017)
MOST_PERMUTED = 4  # components up to which all permutations are tried


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeLoss:
    """Both losses of a batch, and the mask that was matched to each component."""

    masks: Float[Tensor, ""]
    genus: Float[Tensor, ""]
    matched: Int[Tensor, "B K"]


def focal_costs(
    logits: Float[Tensor, "B S K_plus_1"], labels: Int[Tensor, "B S"], *, focus: float = FOCUS
) -> Float[Tensor, "B K_plus_1 K_plus_1"]:
    """Mean focal loss over the queries, split by (mask that is held for it, true label)."""
    masks = logits.shape[-1]
    log_p = functional.log_softmax(logits.float(), dim=-1)
    focal = -((1 - log_p.exp()) ** focus) * log_p
    counts = labels != IGNORED
    true = functional.one_hot(labels.clamp(min=0), masks) * counts[..., None]
    return focal.transpose(1, 2) @ true.to(focal.dtype) / labels.shape[1]


def best_masks(costs: Float[Tensor, "B K K"]) -> Int[Tensor, "B K"]:
    """For each true component the mask that stands for it, at the least total cost."""
    count = costs.shape[-1]
    if count > MOST_PERMUTED:
        from scipy.optimize import linear_sum_assignment

        array = costs.detach().transpose(1, 2).cpu().numpy()
        pairs = [linear_sum_assignment(cost)[1].tolist() for cost in array]
        return torch.tensor(pairs, device=costs.device)
    orders = torch.tensor(list(permutations(range(count))), device=costs.device)
    totals = costs[:, orders, torch.arange(count, device=costs.device)].sum(dim=-1)
    return orders[totals.argmin(dim=1)]


def shape_loss(
    logits: Float[Tensor, "B S K_plus_1"],
    labels: Int[Tensor, "B S"],
    genus_logits: Float[Tensor, "B K classes"],
    genus: Int[Tensor, "B K"],
    *,
    genus_weights: Float[Tensor, " classes"] | None = None,
) -> ShapeLoss:
    """Focal loss of the masks under the best permutation, cross-entropy of the genus under it.

    Args:
        logits: of the masks at the queries, the outliers last.
        labels: true component of each query, K for empty space, IGNORED for none of our business.
        genus_logits: of each mask's component.
        genus: true class of each component; unused components have the class *empty*.
        genus_weights: weight of each class, to balance rare ones.
    """
    count = genus.shape[1]
    costs = focal_costs(logits, labels)
    matched = best_masks(costs[:, :count, :count].detach())
    chosen = costs[:, :count, :count].gather(1, matched[:, None])[:, 0]
    masks = chosen.sum(dim=1) + costs[:, count, count]
    index = matched[..., None].expand(-1, -1, genus_logits.shape[-1])
    of_component = genus_logits.gather(1, index).float()
    return ShapeLoss(
        masks=masks.mean(),
        genus=functional.cross_entropy(
            of_component.flatten(0, 1), genus.flatten(), weight=genus_weights
        ),
        matched=matched,
    )


def latent_loss(
    predicted: Float[Tensor, "B steps T D"],
    true: Float[Tensor, "B steps T D"],
    *,
    seen: Bool[Tensor, "B steps"] | None = None,
    delta: float = 1.0,
) -> Float[Tensor, ""]:
    """Huber loss (1964) between predicted and encoded latents, token by token.

    `seen` leaves out frames whose observation is empty, so that there is nothing to predict.
    """
    loss = functional.huber_loss(predicted, true, reduction="none", delta=delta).mean(dim=(2, 3))
    if seen is None:
        return loss.mean()
    return (loss * seen).sum() / seen.sum().clamp(min=1)
