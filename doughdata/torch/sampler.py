"""The order of samples: shuffled in every epoch, without end, from any position on."""

from collections.abc import Iterator, Sequence, Sized

import numpy as np
from jaxtyping import Float, Int64
from torch.utils.data import Sampler

from doughdata.seeds import seed_sequence

__all__ = ["EndlessSampler"]


class EndlessSampler(Sampler[tuple[int, int]]):
    """Pairs (epoch, index), each epoch a permutation of its own, epoch after epoch.

    With `weights`, an epoch is as many independent draws, a sample as likely as its weight. Then
    the first of a pair numbers the draw, so that what is drawn twice has other points each time.

    The workers of a loader never stop between epochs, so an epoch costs nothing to begin; and the
    order depends on seed and position alone, so a run goes on exactly where it was stopped:
    `EndlessSampler(dataset, start=step * batch_size)`.

    Args:
        dataset: what is drawn from; only its length counts.
        weights: of every sample, in any unit; None = all alike, each once an epoch.
        seed: of the permutations.
        start: samples of this process that are skipped.
        rank: which of several processes this is; each draws its own share of every epoch.
        world_size: how many there are.
    """

    def __init__(
        self,
        dataset: Sized,
        *,
        weights: Sequence[float] | Float[np.ndarray, " samples"] | None = None,
        seed: int = 0,
        start: int = 0,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self._length, self._seed, self._start = len(dataset), seed, start
        self._rank, self._world_size = rank, world_size
        if not 0 <= rank < world_size or self._length < world_size:
            raise ValueError(
                f"rank {rank} of {world_size} processes cannot share {self._length} samples"
            )
        self._chance = None if weights is None else _chance(weights, self._length)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        # Every process has the same share; the rest of an epoch, if any, is left out.
        share = self._length // self._world_size
        epoch, skipped = divmod(self._start, share)
        while True:
            rng = np.random.default_rng(seed_sequence(self._seed, "order", epoch))
            order = self._order(rng)[self._rank :: self._world_size][:share]
            for k in range(skipped, share):
                draw = (epoch * share + k) * self._world_size + self._rank
                yield (epoch if self._chance is None else draw), int(order[k])
            epoch, skipped = epoch + 1, 0

    def _order(self, rng: np.random.Generator) -> Int64[np.ndarray, " samples"]:
        if self._chance is None:
            return rng.permutation(self._length)
        return rng.choice(self._length, self._length, p=self._chance)


def _chance(
    weights: Sequence[float] | Float[np.ndarray, " samples"], count: int
) -> Float[np.ndarray, " samples"]:
    """Probability of each sample."""
    found = np.asarray(weights, np.float64)
    if found.shape != (count,) or not (np.isfinite(found) & (found >= 0)).all() or found.sum() <= 0:
        raise ValueError(
            f"weights must be {count} finite numbers from 0 on, not all 0; got shape {found.shape}"
        )
    return found / found.sum()
