"""Whether one way to train differs from another: the same scenes, the same seeds, side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from doughnet.intervals import covering
from doughschemas import BadInputError

__all__ = ["Compared", "compare", "per_scene"]

DRAWS = 5000
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A figure of one way to train, and how far it is from another's; 95 % intervals."""

    value: float
    interval: Interval
    difference: float  # of the value from the other way's; negative = lower
    difference_interval: Interval

    @property
    def resolved(self) -> bool:
        """Whether the difference has a sign: its interval does not hold zero."""
        low, high = self.difference_interval
        return low > 0 or high < 0


def per_scene(
    tables: Sequence[Mapping[str, Any]], row: str, metric: str
) -> tuple[Float64[np.ndarray, "seeds scenes"], Int64[np.ndarray, " scenes"]]:
    """A metric of every seed and scene, and the frames that it is a mean of.

    Args:
        tables: what `evaluate` gives, one of each seed.
        row: one that comes by scene, as `full_sequence`.
        metric: a column that is a mean over frames, as `viou`.

    Raises:
        BadInputError: the tables are not of the same scenes.
    """
    scenes = [table[row]["by_scene"] for table in tables]
    frames = [[one["frames"] for one in own] for own in scenes]
    if not frames or any(own != frames[0] for own in frames):
        raise BadInputError("tables of the same scenes are needed, one of each seed")
    values = [[one[metric] for one in own] for own in scenes]
    return np.array(values, np.float64), np.array(frames[0], np.int64)


def compare(
    own: Float64[np.ndarray, "seeds scenes"],
    other: Float64[np.ndarray, "seeds scenes"],
    frames: Int64[np.ndarray, " scenes"],
    *,
    seed: int = 0,
) -> Compared:
    """Means over frames, bootstrapped over seeds and scenes together.

    A difference is taken between trainings of one seed on one scene, so that what makes a scene
    hard for both does not blur it.

    Args:
        own: mean of every scene, by seed.
        other: the same of what it is compared with.
        frames: of every scene; the weight of its mean.
        seed: of the draws.
    """
    seeds, scenes = own.shape
    rng = np.random.default_rng(seed)
    by_seed = rng.multinomial(seeds, np.full(seeds, 1 / seeds), DRAWS)
    by_scene = rng.multinomial(scenes, np.full(scenes, 1 / scenes), DRAWS) * frames

    def means(values: Float64[np.ndarray, "seeds scenes"]) -> Float64[np.ndarray, " draws"]:
        total = np.einsum("ds,sn,dn->d", by_seed, values, by_scene)
        return total / (seeds * by_scene.sum(axis=1))

    weights = frames / frames.sum()
    return Compared(
        value=float((own @ weights).mean()),
        interval=covering(means(own)),
        difference=float(((own - other) @ weights).mean()),
        difference_interval=covering(means(own - other)),
    )
