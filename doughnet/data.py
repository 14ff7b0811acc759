"""From a dataset to endless batches: key frames, order, and weights of rare classes."""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import DataLoader

from doughdata.dataset import Dataset
from doughdata.torch import EndlessSampler
from doughdata.torch.views import COMPLETE
from doughnet.config import ModelConfig
from doughnet.stages import Batch

__all__ = ["KEY_FRAMES", "EndlessBatches", "LoaderConfig", "Samples", "class_weights", "key_frames"]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class LoaderConfig:
    """How samples become batches."""

    batch_size: int = 8  # samples a step and process
    workers: int = 1  # processes that read; 0 = the training's own
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
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self.dataset, self.config = dataset, config
        self.rank, self.world_size = rank, world_size

    def __call__(self, step: int) -> Iterator[Batch]:
        """Batches from a step on."""
        config = self.config
        sampler = EndlessSampler(
            self.dataset,
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


def class_weights(
    source: Dataset, config: ModelConfig, *, split: str, frames: Collection[int]
) -> Float[Tensor, " classes"]:
    """Weight of each genus class, 1 / sqrt(frequency): a rare genus is worth learning, too.

    They are scaled so that the expected weight of a component is 1.
    """
    table, wanted = source.frames, set(frames)
    splits = dict(
        zip(
            source.scenes["scene_index"].to_pylist(),
            source.scenes["split"].to_pylist(),
            strict=True,
        )
    )
    counts: Counter[int] = Counter()
    columns = (table[name].to_pylist() for name in ("scene_index", "frame_index", "genus"))
    for scene, frame, genus in zip(*columns, strict=True):
        if frame in wanted and splits[scene] == split and genus is not None:
            known = [min(g, config.max_genus) for g in genus[: config.components]]
            counts.update(known)
            counts[config.empty_class] += config.components - len(known)
    number = torch.tensor([counts[k] for k in range(config.genus_classes)], dtype=torch.float32)
    share = number / number.sum().clamp(min=1)
    weights = torch.where(number > 0, share.clamp(min=1e-9).rsqrt(), 0.0)
    return weights / (weights * share).sum().clamp(min=1e-9)
