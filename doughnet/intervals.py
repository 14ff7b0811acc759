"""How sure a figure is: bootstrap over scenes, whose frames are not independent."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float64, Int64

__all__ = ["bootstrap", "covering"]

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
    return {
        name: [round(edge, 2) for edge in covering([row[name] for row in rows])] for name in rows[0]
    }


def covering(drawn: Sequence[float] | Float64[np.ndarray, " draws"]) -> tuple[float, float]:
    """The 95 % percentile interval of what was drawn."""
    low, high = np.quantile(drawn, [(1 - COVERED) / 2, (1 + COVERED) / 2])
    return float(low), float(high)
