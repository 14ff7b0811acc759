"""What the paper measures: volumetric and component-wise overlap, right counts, right genus.

Components have no order, so every metric is taken under the assignment of predicted to true
components that overlaps best (DoughNet, section 5.1).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["TopologyScore", "component_overlap", "score"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TopologyScore:
    """Metrics of one frame."""

    volume_iou: float  # VIoU: occupied against empty, components ignored
    component_iou: float  # CIoU: mean over the true components under the best assignment
    right_count: bool  # AccC, before averaging
    right_genus: bool  # AccG: all components' genera right under the same assignment


def component_overlap(predicted: Tensor, true: Tensor, *, count: tuple[int, int]) -> Tensor:
    """IoU of every pair of components, (predicted, true).

    Args:
        predicted: label of each sample, (samples,); a label >= count[0] is empty space.
        true: the same for the truth, (samples,).
        count: number of predicted and of true components.
    """
    p = torch.stack([predicted == k for k in range(count[0])]).double()
    t = torch.stack([true == k for k in range(count[1])]).double()
    both = p @ t.T
    return both / (p.sum(1)[:, None] + t.sum(1)[None, :] - both).clamp(min=1)


def score(
    predicted: Tensor, true: Tensor, *, predicted_genus: list[int], true_genus: list[int]
) -> TopologyScore:
    """All four metrics of one frame from labelled samples, (samples,) each.

    A component is empty space when its label is not below the number of its genera.
    """
    count = (len(predicted_genus), len(true_genus))
    occupied = (predicted < count[0], true < count[1])
    union = (occupied[0] | occupied[1]).sum().item()
    volume = (occupied[0] & occupied[1]).sum().item() / union if union else 1.0
    if min(count) == 0:
        same = count[0] == count[1]
        return TopologyScore(
            volume_iou=volume, component_iou=float(same), right_count=same, right_genus=same
        )
    overlap = component_overlap(predicted, true, count=count)
    pairs = _best_pairs(overlap)
    component = sum(overlap[p, t].item() for p, t in pairs) / max(count)
    genus = all(predicted_genus[p] == true_genus[t] for p, t in pairs)
    return TopologyScore(
        volume_iou=volume,
        component_iou=component,
        right_count=count[0] == count[1],
        right_genus=genus and count[0] == count[1],
    )


def _best_pairs(overlap: Tensor) -> list[tuple[int, int]]:
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(overlap.numpy(), maximize=True)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
