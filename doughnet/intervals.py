"""How sure a figure is: bootstrap over scenes, whose frames are not independent."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

__all__ = ["bootstrap"]

DRAWS = 1000
COVERED = 0.95
Scene = TypeVar("Scene")


def bootstrap(
    scenes: Sequence[Scene],
    figures: Callable[[Sequence[Scene]], Mapping[str, float]],
    *,
    seed: int = 0,
) -> dict[str, list[float]]:
    """95 % percentile interval of every figure, scenes drawn again with replacement.

    Args:
        scenes: what was measured of each scene.
        figures: figures of some scenes, by name.
        seed: of the draws.

    Returns:
        Name -> [low, high]; empty without scenes.
    """
    if not scenes:
        return {}
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(DRAWS):
        chosen = rng.integers(0, len(scenes), len(scenes))
        rows.append(figures([scenes[k] for k in chosen]))
    edges = [(1 - COVERED) / 2, (1 + COVERED) / 2]
    return {
        name: [round(float(v), 2) for v in np.quantile([row[name] for row in rows], edges)]
        for name in rows[0]
    }
