"""From what the checks found to the fields of the record."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int32, Int64

from doughdata.topology.pairs import decode, without

__all__ = ["bond_changes"]


def bond_changes(
    bonds: Sequence[Int64[np.ndarray, " _"]], count: int
) -> tuple[tuple[Int32[np.ndarray, "_ 2"], ...], tuple[Int32[np.ndarray, "_ 2"], ...]]:
    """Pairs made and broken at each key frame, from sorted keys; all of frame 0 are made there."""
    made, broken = [], []
    before = np.zeros(0, np.int64)
    for now in bonds:
        same = now is before  # nothing moved
        made.append(_pairs(now[:0] if same else without(now, before), count))
        broken.append(_pairs(now[:0] if same else without(before, now), count))
        before = now
    return tuple(made), tuple(broken)


def _pairs(keys: Int64[np.ndarray, " _"], count: int) -> Int32[np.ndarray, "_ 2"]:
    return decode(keys, count).astype(np.int32)
