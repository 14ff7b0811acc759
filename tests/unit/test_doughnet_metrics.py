"""Metrics of the paper, against cases whose value is plain."""

import pytest
import torch

from doughnet.metrics import score

TRUE = torch.tensor([0, 0, 0, 0, 1, 1, 2, 2])  # two components of 4 and 2 samples, 2 is empty


def test_a_perfect_answer_scores_one_in_any_order() -> None:
    """Renaming the components changes nothing."""
    swapped = torch.tensor([1, 1, 1, 1, 0, 0, 2, 2])
    got = score(swapped, TRUE, predicted_genus=[0, 1], true_genus=[1, 0])
    assert (got.volume_iou, got.component_iou) == (1.0, 1.0)
    assert got.right_count
    assert got.right_genus


def test_merged_components_keep_the_volume_but_lose_the_count() -> None:
    """One blob over both: VIoU 1, CIoU (4/6)/2, count and genus wrong."""
    merged = torch.tensor([0, 0, 0, 0, 0, 0, 1, 1])
    got = score(merged, TRUE, predicted_genus=[1], true_genus=[1, 0])
    assert got.volume_iou == 1.0
    assert got.component_iou == pytest.approx(4 / 6 / 2)
    assert not got.right_count
    assert not got.right_genus


def test_wrong_genus_alone_is_seen() -> None:
    """Right shapes with a wrong genus fail only AccG."""
    got = score(TRUE, TRUE, predicted_genus=[0, 0], true_genus=[1, 0])
    assert got.component_iou == 1.0
    assert got.right_count
    assert not got.right_genus


def test_nothing_predicted_scores_zero() -> None:
    """An empty prediction of a full scene has no overlap."""
    got = score(torch.zeros(8, dtype=torch.long), TRUE, predicted_genus=[], true_genus=[1, 0])
    assert (got.volume_iou, got.component_iou, got.right_count) == (0.0, 0.0, False)
