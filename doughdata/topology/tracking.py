"""From pieces to labels that stay, and from labels and genus to events."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int32, UInt8

from doughdata.topology.pairs import connected
from doughschemas import STRAY, FrameTopology, Particles, TopologyEvent

__all__ = [
    "components_of",
    "count_labels",
    "crumb_limit",
    "find_events",
    "first_labels",
    "groups",
    "next_labels",
]

MOST_COMPONENTS = 250  # labels are bytes, the highest are reserved
SHARED = 0.1  # of the smaller component, that two of different key frames share to be related


def crumb_limit(particles: Particles, share: float, volume: float) -> float:
    """Particles below which a piece is a crumb: less than a share of all and than a volume [m3]."""
    return min(share * len(particles.object_ids), volume / particles.spacing**3)


def components_of(
    pieces: Int32[np.ndarray, " particles"], *, crumb: float
) -> list[Int32[np.ndarray, " _"]]:
    """Particles of each piece of at least `crumb` particles, largest first.

    The largest piece is always a component; so is at most every one of the 250 largest.
    """
    order = np.argsort(pieces, kind="stable").astype(np.int32)
    parts = np.split(order, np.flatnonzero(np.diff(pieces[order])) + 1)
    parts.sort(key=len, reverse=True)
    kept = [part for part in parts if len(part) >= crumb] or parts[:1]
    return kept[:MOST_COMPONENTS]


def first_labels(
    parts: Sequence[Int32[np.ndarray, " _"]],
    positions: Float[np.ndarray, "particles 3"],
    object_ids: UInt8[np.ndarray, " particles"],
) -> UInt8[np.ndarray, " particles"]:
    """Labels of the first frame: by body, then from the largest piece to the smallest."""

    def key(part: Int32[np.ndarray, " _"]) -> tuple[float, ...]:
        middle = positions[part].mean(axis=0).tolist()
        return (float(np.median(object_ids[part])), -float(len(part)), *middle)

    return _label(len(positions), sorted(parts, key=key))


def next_labels(
    parts: Sequence[Int32[np.ndarray, " _"]],
    before: UInt8[np.ndarray, " particles"],
    positions: Float[np.ndarray, "particles 3"],
) -> UInt8[np.ndarray, " particles"]:
    """Labels of the next frame, 0..c-1.

    A component keeps its label while it lives. After a split the largest piece keeps it and the
    others get the next free ones, largest first; a merged component keeps the lowest. Where a label
    dies, the highest takes its place.
    """
    number = count_labels(before)
    shared = np.zeros((len(parts), number), dtype=int)
    for row, part in enumerate(parts):
        old = before[part]
        shared[row] = np.bincount(old[old != STRAY], minlength=number)[:number]
    middle = [tuple(positions[part].mean(axis=0)) for part in parts]
    heirs: list[int | None] = [None] * len(parts)
    for old in range(number):
        best = max(range(len(parts)), key=lambda k: (shared[k, old], middle[k]), default=None)
        if best is not None and shared[best, old] > 0 and heirs[best] is None:
            heirs[best] = old
    kept = {old: row for row, old in enumerate(heirs) if old is not None}
    fresh = sorted(
        (row for row, old in enumerate(heirs) if old is None),
        key=lambda k: (-len(parts[k]), middle[k]),
    )
    free = [k for k in range(len(parts)) if k not in kept]
    high = sorted((old for old in kept if old >= len(parts)), reverse=True)
    moved = [kept.pop(old) for old in high]
    kept |= dict(zip(free, [*moved, *fresh], strict=True))
    return _label(len(before), [parts[kept[k]] for k in range(len(parts))])


def count_labels(labels: UInt8[np.ndarray, " particles"]) -> int:
    """Number of components of a frame's labels."""
    used = labels[labels != STRAY]
    return int(used.max()) + 1 if len(used) else 0


def _label(count: int, parts: Sequence[Int32[np.ndarray, " _"]]) -> UInt8[np.ndarray, " particles"]:
    labels = np.full(count, STRAY, dtype=np.uint8)
    for k, part in enumerate(parts):
        labels[part] = k
    return labels


def find_events(
    frame: int,
    before: FrameTopology,
    after: FrameTopology,
    *,
    cut: Sequence[bool],
    margins: Mapping[str, float],
) -> list[TopologyEvent]:
    """What happened between key frame `frame - 1` and `frame`.

    Components that share particles form a group. Its number of components tells merges and splits;
    what its total genus then gains or loses is a self-merge (a new handle, or a hole that closed)
    or, where the genus fell in a component that was `cut`, a self-split. `margins` are those of the
    decisions around this key frame, by kind (merge, split); 0 where no pull test decided.
    """
    events = []
    for old, new in groups(before, after):
        gain = sum(after.genus[k] for k in new) - sum(before.genus[k] for k in old)
        kinds = []
        if len(old) > 1:
            kinds.append("merge")
        if len(new) > 1:
            kinds.append("split")
        if gain != 0:
            parted = gain < 0 and any(cut[k] for k in new)
            kinds.append("self_split" if parted else "self_merge")
        events += [
            TopologyEvent(
                frame=frame,
                kind=kind,
                components_before=tuple(old),
                components_after=tuple(new),
                margin=float(margins.get(kind.removeprefix("self_"), 0.0)),
            )
            for kind in kinds
        ]
    return events


def groups(before: FrameTopology, after: FrameTopology) -> list[tuple[list[int], list[int]]]:
    """Labels before and after that belong together, in the order of the lowest label."""
    was, now = before.num_components, after.num_components
    if was == now and (now == 1 or np.array_equal(before.labels, after.labels)):
        return [([k], [k]) for k in range(now)]
    both = (before.labels != STRAY) & (after.labels != STRAY)
    cell = before.labels[both].astype(np.intp) * now + after.labels[both]
    table = np.bincount(cell, minlength=was * now).reshape(was, now)
    size_was = np.bincount(before.labels[before.labels != STRAY], minlength=was)
    size_now = np.bincount(after.labels[after.labels != STRAY], minlength=now)
    smaller = np.minimum(size_was[:, None], size_now[None, :])
    rows, columns = np.nonzero(table > SHARED * np.maximum(smaller, 1))
    group = connected(np.stack([rows, columns + was], axis=1), was + now)
    found = []
    for number in dict.fromkeys(group.tolist()):
        members = np.flatnonzero(group == number)
        old = [int(k) for k in members if k < was]
        new = [int(k) - was for k in members if k >= was]
        if old and new:  # else a crumb that grew or a component that crumbled
            found.append((old, new))
    return found
