"""Losses: the matrix shortcut against every permutation written out, and limits in closed form."""

import math
from itertools import permutations

import pytest
import torch
from scipy.optimize import linear_sum_assignment

from doughnet.losses import IGNORED, best_masks, focal_costs, latent_loss, shape_loss
from doughnet.stages import genus_classes, query_classes


def focal_written_out(logits: torch.Tensor, labels: torch.Tensor) -> torch.Tensor:
    """Mean focal loss of one sample whose labels name masks."""
    p = torch.softmax(logits, dim=-1).gather(1, labels[:, None])[:, 0]
    return (-((1 - p) ** 2) * p.log()).mean()


@pytest.mark.parametrize("components", [1, 2, 3, 4])
def test_the_matrix_shortcut_is_the_best_of_all_permutations(components: int) -> None:
    """The loss is the least focal loss over all K! ways to name the masks, the outliers fixed."""
    rng = torch.Generator().manual_seed(components)
    logits = torch.randn(3, 50, components + 1, generator=rng, dtype=torch.float64) * 3
    labels = torch.randint(0, components + 1, (3, 50), generator=rng)
    genus_logits = torch.randn(3, components, 4, generator=rng, dtype=torch.float64)
    genus = torch.randint(0, 4, (3, components), generator=rng)
    found = shape_loss(logits, labels, genus_logits, genus)
    best = []
    for k in range(3):
        ways = []
        for order in permutations(range(components)):
            names = torch.tensor([*order, components])  # component j is named order[j]
            ways.append((focal_written_out(logits[k], names[labels[k]]).item(), order))
        best.append(min(ways))
    assert found.masks.item() == pytest.approx(sum(cost for cost, _ in best) / 3, rel=1e-5)
    assert [tuple(row) for row in found.matched.tolist()] == [order for _, order in best]
    chosen = torch.stack([genus_logits[k][list(order)] for k, (_, order) in enumerate(best)])
    expected = torch.nn.functional.cross_entropy(chosen.flatten(0, 1), genus.flatten())
    assert found.genus.item() == pytest.approx(expected.item(), rel=1e-5)


def test_renaming_components_changes_no_loss() -> None:
    """True components in another order have the same losses."""
    rng = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 80, 5, generator=rng)
    labels = torch.randint(0, 5, (2, 80), generator=rng)
    genus_logits, genus = torch.randn(2, 4, 4, generator=rng), torch.tensor([[0, 1, 2, 3]] * 2)
    order = torch.tensor([2, 0, 3, 1, 4])
    renamed = torch.empty_like(genus)
    renamed[:, order[:4]] = genus
    one = shape_loss(logits, labels, genus_logits, genus)
    two = shape_loss(logits, order[labels], genus_logits, renamed)
    torch.testing.assert_close(one.masks, two.masks)
    torch.testing.assert_close(one.genus, two.genus)


def test_beyond_four_components_the_hungarian_method_is_used() -> None:
    """Six masks are matched as scipy matches them."""
    costs = torch.rand(5, 6, 6, generator=torch.Generator().manual_seed(0))
    for cost, matched in zip(costs, best_masks(costs), strict=True):
        rows, columns = linear_sum_assignment(cost.numpy())
        assert cost[matched, torch.arange(6)].sum().item() == pytest.approx(
            cost.numpy()[rows, columns].sum(), rel=1e-6
        )


def test_ignored_queries_and_even_logits() -> None:
    """Equal logits cost (1 - p)^2 log 1/p at p = 1/5; ignored queries cost nothing."""
    labels = torch.tensor([[0, 1, 4, IGNORED]])
    costs = focal_costs(torch.zeros(1, 4, 5), labels)
    each = 0.8**2 * math.log(5)
    assert costs.sum(dim=(0, 1)).tolist() == pytest.approx(
        [5 * each / 4, 5 * each / 4, 0, 0, 5 * each / 4], rel=1e-5
    )


def test_latent_loss_is_hubers() -> None:
    """Half the square near zero, linear beyond one; frames without a view count for nothing."""
    predicted = torch.zeros(1, 2, 3, 4)
    true = torch.stack([torch.full((1, 3, 4), 0.5), torch.full((1, 3, 4), 3.0)], dim=1)
    assert latent_loss(predicted, true).item() == pytest.approx((0.125 + 2.5) / 2)
    seen = torch.tensor([[True, False]])
    assert latent_loss(predicted, true, seen=seen).item() == pytest.approx(0.125)


def test_targets_of_a_loader_sample() -> None:
    """Empty space becomes the outlier mask, components without a mask are ignored, a high genus
    counts as the highest class, and free places are empty.
    """
    from doughnet.config import ModelConfig

    labels = query_classes(torch.tensor([[0, 5, 6]]), torch.tensor([6]), components=4)
    assert labels.tolist() == [[0, IGNORED, 4]]
    config = ModelConfig(components=4, max_genus=2)
    assert genus_classes(torch.tensor([[0, 3, -1]]), config).tolist() == [[0, 2, 3, 3]]
    assert genus_classes(torch.tensor([[1, 0, 0, 0, 2]]), config).tolist() == [[1, 0, 0, 0]]
