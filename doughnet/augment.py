"""Augmentation of batches: what must not matter, drawn again for every batch.

Everything turns a little about z, and more or mirrored if that is asked for, in all frames of a
sample alike; components change their names; points are moved, dropped or lose their labels, as a
camera and a segmentation would.

A turn also moves the camera, and where it stands says which side is hidden. So turning any way
round costs a model of few steps a lot (`LOG.md`); it is for data with cameras all around.
A batch has one axis before its frames, or none: single views have no axis of frames.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from doughschemas import NO_COMPONENT

__all__ = ["Augmentation", "augmented"]

PLACES = ("points", "queries", "tool_points")


@dataclass(frozen=True, slots=True, kw_only=True)
class Augmentation:
    """How much is changed; zero and False leave a batch as it is."""

    turn: float = math.radians(10)  # greatest angle about z, either way; pi = any
    mirror: bool = False  # x -> -x, half of the time
    shuffle_components: bool = True
    point_noise: float = 0.5e-3  # [m], standard deviation
    point_dropout: float = 0.5  # most points that are dropped; others take their place
    label_dropout: float = 0.25  # share of samples in which no point has a label


def augmented(
    batch: dict[str, Tensor], augmentation: Augmentation, *, seed: int, components: int
) -> dict[str, Tensor]:
    """A changed copy of a batch; the same seed changes it in the same way.

    Args:
        batch: tensors as `doughdata.torch` serves them; `points` is (B, [frames,] N, 3).
        augmentation: what to do.
        seed: of this batch.
        components: names that are shuffled; others stay.
    """
    device, count = batch["points"].device, len(batch["points"])
    rng = torch.Generator().manual_seed(seed)
    out = dict(batch)
    matrix = _motions(count, augmentation, rng).to(device)
    for name in PLACES:
        if name in batch:
            flat = batch[name].flatten(1, -2) @ matrix.transpose(1, 2)
            out[name] = flat.reshape(batch[name].shape)
    if augmentation.shuffle_components:
        names = torch.stack([torch.randperm(components, generator=rng) for _ in range(count)])
        out["point_labels"] = _renamed(out["point_labels"], names.to(device))
    _spoil_points(out, augmentation, rng)
    return out


def _motions(
    count: int, augmentation: Augmentation, rng: torch.Generator
) -> Float[Tensor, "count 3 3"]:
    """One rotation about z a sample, with a mirror image half of the time if that is asked for."""
    angle = (2 * torch.rand(count, generator=rng) - 1) * augmentation.turn
    side = torch.randint(0, 2, (count,), generator=rng) * 2 - 1 if augmentation.mirror else 1
    cosine, sine, zero = angle.cos(), angle.sin(), torch.zeros(count)
    rows = [cosine * side, -sine, zero, sine * side, cosine, zero, zero, zero, zero + 1]
    return torch.stack(rows, dim=1).reshape(count, 3, 3)


def _renamed(labels: Tensor, names: Tensor) -> Tensor:
    """Labels below the number of names under their new name; others stay as they are."""
    components = names.shape[1]
    flat = labels.flatten(1)
    known = (flat >= 0) & (flat < components)
    new = names.gather(1, flat.clamp(0, components - 1))
    return torch.where(known, new, flat).reshape(labels.shape)


def _spoil_points(
    batch: dict[str, Tensor], augmentation: Augmentation, rng: torch.Generator
) -> None:
    points, labels = batch["points"], batch["point_labels"]
    device, number = points.device, points.shape[-2]
    # The points are in random order: those beyond the kept ones repeat the kept ones.
    dropped = torch.rand(len(points), generator=rng) * augmentation.point_dropout
    kept = ((1 - dropped) * number).long().clamp(min=1)
    index = (torch.arange(number)[None] % kept[:, None]).to(device)
    index = index.reshape(len(points), *[1] * (labels.ndim - 2), number).expand(labels.shape)
    points = points.gather(-2, index[..., None].expand(points.shape))
    labels = labels.gather(-1, index)
    noise = torch.randn(points.shape, generator=rng).to(device) * augmentation.point_noise
    hidden = (torch.rand(len(points), generator=rng) < augmentation.label_dropout).to(device)
    hidden = hidden.reshape(-1, *[1] * (labels.ndim - 1))
    batch["points"] = torch.where((labels >= 0)[..., None], points + noise, points)
    batch["point_labels"] = torch.where(hidden & (labels >= 0), NO_COMPONENT, labels)
