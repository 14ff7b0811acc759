"""Components over time: while one stays the same, few of its key frames have to be read."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int64, UInt8

from doughdata.topology.tracking import count_labels

__all__ = ["refine", "runs_of"]

STRIDE = 6  # key frames between two readings that agree
SAME = 0.02  # share of particles that a component may lose or win and be the same


def refine(
    low: int,
    high: int,
    read: Callable[[int], object],
    settled: Callable[[int, int], bool],
    likely: Callable[[int, int], Sequence[int]] | None = None,
    *,
    finest: int = 1,
) -> None:
    """Read between two key frames until readings that agree are at most `STRIDE` apart.

    Or until `settled` says that nothing can have changed between them. Two readings that differ are
    approached from the middle, or from the middle one of the `likely` key frames after the first,
    until they are `finest` apart.
    """
    if read(low) == read(high) and (high - low <= STRIDE or settled(low, high)):
        return
    if high - low <= finest:
        return
    before = after = (low + high) // 2
    if likely is not None and read(low) != read(high) and (frames := likely(low, high)):
        after = frames[len(frames) // 2]
        before = after - 1
    refine(low, before, read, settled, likely, finest=finest)
    refine(after, high, read, settled, likely, finest=finest)


def runs_of(
    labels: Sequence[UInt8[np.ndarray, " particles"]],
) -> list[tuple[int, int, list[Int64[np.ndarray, " _"]]]]:
    """Label, first key frame and members of every component while it stays the same."""
    done: list[tuple[int, int, list[Int64[np.ndarray, " _"]]]] = []
    alive: dict[int, tuple[int, int, list[Int64[np.ndarray, " _"]]]] = {}
    for frame, own in enumerate(labels):
        now = {}
        for label in range(count_labels(own)):
            members = np.flatnonzero(own == label)
            run = alive.get(label)
            if run is not None and _same(run[2][-1], members):
                run[2].append(members)
            else:
                run = (label, frame, [members])
                done.append(run)
            now[label] = run
        alive = now
    return sorted(done, key=lambda run: run[0])


def _same(before: Int64[np.ndarray, " _"], after: Int64[np.ndarray, " _"]) -> bool:
    return len(np.setxor1d(before, after)) <= SAME * max(len(before), len(after))
