"""Procedural shapes against their volumes in closed form; augmentation as a rigid motion."""

import math

import pytest
import torch

from doughnet.augment import Augmentation, augmented
from doughnet.procedural import BOX, Shapes, random_shapes, sample_batch, stream
from doughschemas import NO_COMPONENT

VOLUMES = {  # kind -> size [m], volume [m3]
    0: ((0.02, 0.0, 0.0), 4 / 3 * math.pi * 0.02**3),
    1: ((0.01, 0.02, 0.015), 8 * 0.01 * 0.02 * 0.015),
    2: ((0.01, 0.02, 0.0), math.pi * 0.01**2 * 0.04 + 4 / 3 * math.pi * 0.01**3),
    3: ((0.008, 0.022, 0.0), 2 * math.pi**2 * 0.022 * 0.008**2),
}


@pytest.mark.parametrize("kind", VOLUMES)
def test_shapes_have_their_volume_wherever_they_lie(kind: int) -> None:
    """The share of random points inside is the closed-form volume, turned and moved."""
    size, volume = VOLUMES[kind]
    shape = Shapes(
        kind=torch.tensor([[kind, 0]]),
        size=torch.tensor([[size, size]]),
        centre=torch.tensor([[[0.01, -0.02, 0.03], [0.0, 0.0, 0.0]]]),
        yaw=torch.tensor([[0.7, 0.0]]),
        present=torch.tensor([[True, False]]),
    )
    rng = torch.Generator().manual_seed(kind)
    count, edge = 400_000, 0.1
    points = (torch.rand(1, count, 3, generator=rng) - 0.5) * edge + shape.centre[:, :1]
    share = (shape.labels(points) == 0).float().mean().item()
    expected = volume / edge**3
    assert share == pytest.approx(expected, abs=4 * math.sqrt(expected / count))


def test_distances_are_distances() -> None:
    """The gradient of every distance has length one almost everywhere (eikonal equation)."""
    rng = torch.Generator().manual_seed(0)
    shapes = random_shapes(64, rng)
    points = (torch.rand(64, 100, 3, generator=rng) * 0.1 - 0.05).requires_grad_()
    (slope,) = torch.autograd.grad(shapes.distance(points)[:, 0].sum(), points)
    assert (slope.norm(dim=-1) - 1).abs().median() < 1e-4


def test_samples_lie_where_they_say() -> None:
    """Points lie on the surface of the object that they name, queries are labelled by distance,
    objects do not overlap and stay in the box; a batch depends on its seed and step alone.
    """
    rng = torch.Generator().manual_seed(0)
    shapes = random_shapes(64, rng)
    batch = sample_batch(shapes, rng)
    distance = shapes.distance(batch["points"])
    assert distance.gather(1, batch["point_labels"][:, None]).abs().max() < 1e-3
    where = shapes.distance(batch["queries"])
    assert ((where <= 0).sum(dim=1) <= 1).all()
    assert torch.equal(
        (where <= 0).any(dim=1), batch["query_labels"] < batch["num_components"][:, None]
    )
    box = torch.tensor(BOX)
    inside = where.amin(dim=1) <= 0
    assert (batch["queries"][inside] > box[0] - 1e-3).all()
    assert (batch["queries"][inside] < box[1] + 1e-3).all()
    later = stream(5, batch_size=4, step=3)
    again = stream(5, batch_size=4)
    for _ in range(3):
        next(again)
    one, two = next(later), next(again)
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_augmentation_is_one_rigid_motion_for_all_of_a_sample() -> None:
    """Distances between points, queries and tool points stay, heights stay, the same seed gives
    the same, and queries keep their labels.
    """
    rng = torch.Generator().manual_seed(0)
    batch = {
        "points": torch.rand(3, 2, 20, 3, generator=rng),
        "point_labels": torch.randint(0, 4, (3, 2, 20), generator=rng),
        "queries": torch.rand(3, 2, 10, 3, generator=rng),
        "tool_points": torch.rand(3, 2, 2, 5, 3, generator=rng),
    }
    rigid = Augmentation(
        turn=math.pi, mirror=True, point_noise=0.0, point_dropout=0.0, label_dropout=0.0
    )
    out = augmented(batch, rigid, seed=7, components=4)
    names = ("points", "queries", "tool_points")
    before, after = (
        torch.cat([b[name].flatten(1, -2) for name in names], dim=1) for b in (batch, out)
    )
    torch.testing.assert_close(
        torch.cdist(after, after), torch.cdist(before, before), atol=1e-3, rtol=0
    )
    torch.testing.assert_close(after[..., 2], before[..., 2])
    assert (after - before).abs().max() > 0.1
    again = augmented(batch, rigid, seed=7, components=4)
    assert all(torch.equal(out[name], again[name]) for name in out)
    pairs = set(zip(batch["point_labels"][0].flatten().tolist(),
                    out["point_labels"][0].flatten().tolist(), strict=True))  # fmt: skip
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


@pytest.mark.parametrize("most", [0.0, 0.1, 1.0])
def test_no_sample_turns_further_than_it_may(most: float) -> None:
    """All angles up to the greatest one occur, either way, and none beyond; nothing is mirrored."""
    point = torch.tensor([1.0, 0.0, 0.5]).expand(400, 1, 3)
    batch = {"points": point, "point_labels": torch.zeros(400, 1, dtype=torch.int64)}
    still = Augmentation(turn=most, point_noise=0.0, point_dropout=0.0)
    out = augmented(batch, still, seed=2, components=4)["points"][:, 0]
    angle = torch.atan2(out[:, 1], out[:, 0])
    assert angle.abs().max() <= most + 1e-6
    assert angle.max() >= 0.95 * most
    assert angle.min() <= -0.95 * most
    torch.testing.assert_close(out[:, 2], point[:, 0, 2])


def test_spoiled_points_come_from_the_view() -> None:
    """Dropped points are replaced by kept ones; without labels all points say so; padding stays."""
    rng = torch.Generator().manual_seed(0)
    points = torch.rand(8, 50, 3, generator=rng)
    labels = torch.zeros(8, 50, dtype=torch.int64)
    labels[0] = -1
    batch = {"points": points, "point_labels": labels}
    spoil = Augmentation(turn=0.0, point_noise=0.0, label_dropout=1.0)
    out = augmented(batch, spoil, seed=1, components=4)
    for before, after in zip(points, out["points"], strict=True):
        distance = torch.cdist(after.double(), before.double()).amin(dim=1)
        assert distance.max() < 1e-6
    assert (out["point_labels"][0] == -1).all()
    assert (out["point_labels"][1:] == NO_COMPONENT).all()
    assert min(len(cloud.unique(dim=0)) for cloud in out["points"]) < 50
