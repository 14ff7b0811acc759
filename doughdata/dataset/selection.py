"""Choosing scenes: by index, family, split, region, by how they end and by what happens in them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from doughdata.dataset.reader import Dataset
from doughdata.dataset.statistics import topology_name
from doughschemas import BadInputError

__all__ = ["SceneFilter", "format_indices", "parse_indices"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFilter:
    """What a chosen scene must satisfy; an empty condition allows everything."""

    scenes: tuple[int, ...] = ()  # scene_index
    families: tuple[str, ...] = ()
    splits: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()
    final: tuple[str, ...] = ()  # topology of the last key frame: "c=2 g=0,1", or "c=2" alone
    events: tuple[str, ...] = ()  # at least one of these kinds happens

    def choose(self, dataset: Dataset) -> list[int]:
        """scene_index of every scene of a dataset that satisfies all conditions, rising.

        Raises:
            BadInputError: a condition names something that the dataset does not have, or nothing
                is left.
        """
        table = dataset.scenes
        left = set(table["scene_index"].to_pylist())
        if self.scenes:
            left &= set(_known("scene", self.scenes, left))
        for column in ("family", "split", "region"):
            wanted = {"family": self.families, "split": self.splits, "region": self.regions}[column]
            if wanted:
                there = table[column].to_pylist()
                _known(column, wanted, there)
                left &= _where(table["scene_index"].to_pylist(), there, wanted)
        if self.final:
            final = _final(dataset)
            names = list(final.values())
            _known("final topology", self.final, [*names, *(n.split()[0] for n in names)])
            left &= {i for i, n in final.items() if {n, n.split()[0]} & set(self.final)}
        if self.events:
            events = dataset.table("topology_events")
            kinds = events["kind"].to_pylist()
            _known("event", self.events, kinds)
            left &= _where(events["scene_index"].to_pylist(), kinds, self.events)
        if not left:
            raise BadInputError(f"{dataset.uri}: no scene satisfies all conditions")
        return sorted(left)


def parse_indices(text: str) -> tuple[int, ...]:
    """`0,4-9` -> 0, 4, 5, 6, 7, 8, 9.

    Raises:
        BadInputError: anything else.
    """
    found: list[int] = []
    for part in text.split(","):
        low, dash, high = part.strip().partition("-")
        if not low.isdigit() or (dash and not high.isdigit()):
            raise BadInputError(f"scenes are given like 0,4-9, got {text!r}")
        if dash and int(high) < int(low):
            raise BadInputError(f"a range of scenes rises, got {part.strip()!r}")
        found += range(int(low), int(high or low) + 1)
    return tuple(sorted(set(found)))


def format_indices(indices: Iterable[int]) -> str:
    """The shortest text that `parse_indices` turns back into these indices."""
    runs: list[list[int]] = []
    for index in sorted(set(indices)):
        if runs and index == runs[-1][-1] + 1:
            runs[-1][1:] = [index]
        else:
            runs.append([index])
    return ",".join("-".join(map(str, run)) for run in runs)


def _final(dataset: Dataset) -> dict[int, str]:
    """scene_index -> topology of its last key frame, of all scenes that were checked."""
    columns = ("scene_index", "num_components", "genus")
    frames = dataset.frames.select(columns).take(_last_rows(dataset))
    rows = zip(*(frames[name].to_pylist() for name in columns), strict=True)
    return {scene: topology_name(c, genus) for scene, c, genus in rows if c is not None}


def _last_rows(dataset: Dataset) -> list[int]:
    last = dataset.num_frames - 1
    frames = dataset.frames["frame_index"].to_pylist()
    return [row for row, frame in enumerate(frames) if frame == last]


def _where(indices: Sequence[int], values: Sequence[str], wanted: Sequence[str]) -> set[int]:
    return {i for i, value in zip(indices, values, strict=True) if value in wanted}


def _known(kind: str, wanted: Iterable, there: Iterable) -> Iterable:
    """The wanted values; BadInputError if one of them is nowhere."""
    known = set(there)
    if wrong := [value for value in wanted if value not in known]:
        listed = ", ".join(map(str, sorted(known)[:12])) or "none"
        raise BadInputError(f"the dataset has no {kind} {wrong[0]!r} (it has: {listed})")
    return wanted
