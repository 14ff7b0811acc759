"""From a dataset to endless batches: key frames, order, and weights of rare classes."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor
from torch.utils.data import DataLoader

from doughdata.dataset import Dataset
from doughdata.torch import EndlessSampler
from doughdata.torch.views import COMPLETE
from doughnet.config import ModelConfig
from doughnet.stages import Batch

__all__ = [
    "KEY_FRAMES",
    "EndlessBatches",
    "LoaderConfig",
    "PlacedSamples",
    "Samples",
    "balancing",
    "class_weights",
    "key_frames",
]

KEY_FRAMES = tuple(range(5, 70, 5))  # the 13 of the paper, of 75


class Samples(Protocol):
    """A map-style dataset of (epoch, index) that says where its samples come from."""

    source: Dataset
    sensor: str

    def __len__(self) -> int:
        """Number of samples."""
        ...

    def __getitem__(self, index: tuple[int, int], /) -> dict[str, Tensor]:
        """One sample."""
        ...


class PlacedSamples(Samples, Protocol):
    """Samples that also say which key frame each of them shows."""

    @property
    def places(self) -> Int64[np.ndarray, "samples 2"]:
        """(scene_index, frame_index) of each, of the last one in a window."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class LoaderConfig:
    """How samples become batches."""

    batch_size: int = 8  # samples a step and process
    workers: int = 1  # processes that read; 0 = the training's own
    balance: bool = True  # draw rare topologies more often than they occur
    seed: int = 0


def key_frames(source: Dataset, sensor: str) -> tuple[int, ...]:
    """The paper's key frames if all of them were rendered, else every one that was."""
    if sensor == COMPLETE:
        there = set(range(source.num_frames))
        return KEY_FRAMES if there.issuperset(KEY_FRAMES) else tuple(sorted(there))
    views = source.table("views")
    layer = f"depth.{sensor}"
    pairs = zip(views["layer"].to_pylist(), views["frame_index"].to_pylist(), strict=True)
    there = {frame for name, frame in pairs if name == layer}
    return KEY_FRAMES if there.issuperset(KEY_FRAMES) else tuple(sorted(there))


class EndlessBatches:
    """Batches of a dataset from any step on, without end."""

    def __init__(
        self,
        dataset: Samples,
        config: LoaderConfig,
        *,
        weights: Float64[np.ndarray, " samples"] | None = None,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self.dataset, self.config, self.weights = dataset, config, weights
        self.rank, self.world_size = rank, world_size

    def __call__(self, step: int) -> Iterator[Batch]:
        """Batches from a step on."""
        config = self.config
        sampler = EndlessSampler(
            self.dataset,
            weights=self.weights,
            seed=config.seed,
            start=step * config.batch_size,
            rank=self.rank,
            world_size=self.world_size,
        )
        samples: Any = self.dataset
        loader = DataLoader(
            samples,
            batch_size=config.batch_size,
            sampler=sampler,
            num_workers=config.workers,
            # A fork would copy the state of torch's and Arrow's threads.
            multiprocessing_context="forkserver" if config.workers else None,
        )
        return iter(loader)


def balancing(data: PlacedSamples) -> Float64[np.ndarray, " samples"]:
    """How often to draw each sample: a topology as the root of its frequency, not as that itself.

    A window counts for its last key frame; a topology is the genera of all components, sorted.
    """
    classes = [None if genus is None else tuple(sorted(genus)) for genus in _genera(data)]
    number = Counter(classes)
    return np.array([number[found] ** -0.5 for found in classes])


def class_weights(
    data: PlacedSamples, config: ModelConfig, drawn: Float64[np.ndarray, " samples"] | None = None
) -> Float[Tensor, " classes"]:
    """Weight of each genus class, 1 / sqrt(frequency): a rare genus is worth learning, too.

    They are scaled so that the expected weight of a component is 1.

    Args:
        data: what is trained on.
        config: knows the classes.
        drawn: how often each sample is drawn, in any unit; None = all alike.
    """
    number = np.zeros(config.genus_classes)
    genera = _genera(data)
    for genus, weight in zip(genera, np.ones(len(genera)) if drawn is None else drawn, strict=True):
        if genus is not None:
            for g in genus[: config.components]:
                number[min(g, config.max_genus)] += weight
            number[config.empty_class] += weight * max(0, config.components - len(genus))
    share = torch.from_numpy(number / max(number.sum(), 1e-9)).float()
    weights = torch.where(share > 0, share.clamp(min=1e-9).rsqrt(), 0.0)
    return weights / (weights * share).sum().clamp(min=1e-9)


def _genera(data: PlacedSamples) -> list[list[int] | None]:
    """Genera of the components at the place of each sample; None where nobody knows."""
    table = data.source.frames
    columns = (table[name].to_pylist() for name in ("scene_index", "frame_index", "genus"))
    known = {(scene, frame): genus for scene, frame, genus in zip(*columns, strict=True)}
    return [known.get((scene, frame)) for scene, frame in data.places.tolist()]
