"""What the paper measures: volumetric and component-wise overlap, right counts, right genus.

Components have no order, so every metric is taken under the assignment of predicted to true
components that overlaps best (DoughNet, section 5.1).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int
from torch import Tensor

__all__ = ["UNASSIGNED", "TopologyScore", "component_overlap", "score"]

UNASSIGNED = -1  # label of a sample that is dough but belongs to no component


@dataclass(frozen=True, slots=True, kw_only=True)
class TopologyScore:
    """Metrics of one frame."""

    volume_iou: float  # VIoU: occupied against empty, components ignored
    component_iou: float  # CIoU: mean over the true components under the best assignment; one
    # that is missing counts 0, one too many lowers AccC alone
    right_count: bool  # AccC, before averaging
    right_genus: bool  # AccG: the count and all components' genera right under that assignment
    genus_share: float = 0.0  # true components that were found with their genus


def component_overlap(
    predicted: Int[Tensor, " samples"], true: Int[Tensor, " samples"], *, count: tuple[int, int]
) -> Float64[Tensor, "predicted true"]:
    """IoU of every pair of components, (predicted, true).

    Args:
        predicted: label of each sample, (samples,); a label >= count[0] is empty space.
        true: the same for the truth, (samples,).
        count: number of predicted and of true components.
    """
    both = _table(predicted, true, count).double()
    both, sizes = both[: count[0], : count[1]], (both.sum(dim=1), both.sum(dim=0))
    either = sizes[0][: count[0], None] + sizes[1][None, : count[1]] - both
    return both / either.clamp(min=1)


def score(
    predicted: Int[Tensor, " samples"],
    true: Int[Tensor, " samples"],
    *,
    predicted_genus: list[int],
    true_genus: list[int],
) -> TopologyScore:
    """All metrics of one frame from labelled samples, (samples,) each.

    A sample is empty space when its label is not below the number of the genera, and dough of no
    component when it is negative: that counts for the volume alone.
    """
    count = (len(predicted_genus), len(true_genus))
    dough = (predicted < count[0], true < count[1])
    union = int((dough[0] | dough[1]).sum())
    volume = int((dough[0] & dough[1]).sum()) / union if union else 1.0
    if min(count) == 0:
        same = count[0] == count[1]
        return TopologyScore(
            volume_iou=volume,
            component_iou=float(same),
            right_count=same,
            right_genus=same,
            genus_share=float(same),
        )
    overlap = component_overlap(predicted, true, count=count)
    pairs = _best_pairs(overlap)
    right = [predicted_genus[p] == true_genus[t] for p, t in pairs]
    return TopologyScore(
        volume_iou=volume,
        component_iou=sum(overlap[p, t].item() for p, t in pairs) / count[1],
        right_count=count[0] == count[1],
        right_genus=all(right) and count[0] == count[1],
        genus_share=sum(right) / count[1],
    )


def _table(predicted: Tensor, true: Tensor, count: tuple[int, int]) -> Tensor:
    """How many samples have each pair of labels; the last row and column are everything else."""

    def clipped(labels: Tensor, most: int) -> Tensor:
        labels = labels.long()
        return torch.where((labels < 0) | (labels > most), most, labels)

    pair = clipped(predicted, count[0]) * (count[1] + 1) + clipped(true, count[1])
    counts = torch.bincount(pair, minlength=(count[0] + 1) * (count[1] + 1))
    return counts.reshape(count[0] + 1, count[1] + 1)


def _best_pairs(overlap: Tensor) -> list[tuple[int, int]]:
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(overlap.numpy(), maximize=True)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
