"""The order of samples: shuffled in every epoch, without end, from any position on."""

from collections.abc import Iterator, Sized

import numpy as np
from torch.utils.data import Sampler

from doughdata.seeds import seed_sequence

__all__ = ["EndlessSampler"]


class EndlessSampler(Sampler[tuple[int, int]]):
    """Pairs (epoch, index), each epoch a permutation of its own, epoch after epoch.

    The workers of a loader never stop between epochs, so an epoch costs nothing to begin; and the
    order depends on seed and position alone, so a run goes on exactly where it was stopped:
    `EndlessSampler(dataset, start=step * batch_size)`.

    Args:
        dataset: what is drawn from; only its length counts.
        seed: of the permutations.
        start: samples of this process that are skipped.
        rank: which of several processes this is; each draws its own share of every epoch.
        world_size: how many there are.
    """

    def __init__(
        self, dataset: Sized, *, seed: int = 0, start: int = 0, rank: int = 0, world_size: int = 1
    ) -> None:
        self._length, self._seed, self._start = len(dataset), seed, start
        self._rank, self._world_size = rank, world_size
        if not 0 <= rank < world_size or self._length < world_size:
            raise ValueError(
                f"rank {rank} of {world_size} processes cannot share {self._length} samples"
            )

    def __iter__(self) -> Iterator[tuple[int, int]]:
        # Every process has the same share; the rest of an epoch, if any, is left out.
        share = self._length // self._world_size
        epoch, skipped = divmod(self._start, share)
        while True:
            rng = np.random.default_rng(seed_sequence(self._seed, "order", epoch))
            order = rng.permutation(self._length)[self._rank :: self._world_size][:share]
            for index in order[skipped:].tolist():
                yield epoch, index
            epoch, skipped = epoch + 1, 0
