"""Train and test regions: disjoint in body scale and in tool scale.

A scale is a number u in [0, 1] that a family maps to its own range. Training leaves a gap in the
middle and a band at both ends; test scenes come from the gap (interpolation) or from the bands
(extrapolation), for body and tool alike.
"""

import numpy as np

from doughschemas import BadInputError

__all__ = ["REGIONS", "sample_region", "sample_scale"]

REGIONS = {
    "train": ((0.10, 0.45), (0.55, 0.90)),
    "interpolation": ((0.46, 0.54),),
    "extrapolation": ((0.00, 0.09), (0.91, 1.00)),
}


def sample_region(split: str, rng: np.random.Generator) -> str:
    """Region of one scene: `train`, or one of the two test regions with equal chance.

    Raises:
        BadInputError: the split is neither train nor test.
    """
    if split == "train":
        return "train"
    if split == "test":
        return str(rng.choice(["interpolation", "extrapolation"]))
    raise BadInputError(f"split must be train or test, got {split!r}")


def sample_scale(region: str, rng: np.random.Generator) -> float:
    """Uniform over the intervals of a region."""
    intervals = np.array(REGIONS[region])
    width = intervals[:, 1] - intervals[:, 0]
    low, high = intervals[rng.choice(len(intervals), p=width / width.sum())]
    return float(rng.uniform(low, high))
