"""How sure a figure is: bootstrap over scenes, whose frames are not independent."""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Int64

__all__ = ["bootstrap"]

DRAWS = 1000
COVERED = 0.95


def bootstrap(
    count: int,
    figures: Callable[[Int64[np.ndarray, " scenes"]], Mapping[str, float]],
    *,
    seed: int = 0,
) -> dict[str, list[float]]:
    """95 % percentile interval of every figure, scenes drawn again with replacement.

    Args:
        count: number of scenes.
        figures: figures by name, of scenes that count so many times each, (scenes,).
        seed: of the draws.

    Returns:
        Name -> [low, high]; empty without scenes.
    """
    if count == 0:
        return {}
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(count, np.full(count, 1 / count), DRAWS)
    rows = [figures(times) for times in drawn]
    edges = [(1 - COVERED) / 2, (1 + COVERED) / 2]
    return {
        name: [round(float(v), 2) for v in np.quantile([row[name] for row in rows], edges)]
        for name in rows[0]
    }
