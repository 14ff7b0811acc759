"""What a dataset holds in numbers: how scenes end, what happens in them, ranges of features."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

__all__ = [
    "Moments",
    "dataset_sizes",
    "table_features",
    "topology_name",
    "topology_statistics",
]

FEATURES = {  # table -> numeric columns worth a range; lists count component by component
    "scenes": ("duration", "num_particles", "particle_spacing", "num_bodies", "num_actions"),
    "frames": ("timestamp", "opening", "num_particles", "num_components", "genus"),
    "tool_poses": ("position", "quaternion", "opening"),
    "graph_nodes": ("position", "particles"),
    "views": ("position", "quaternion", "fx", "fy", "cx", "cy"),
}


@dataclass(slots=True)
class Moments:
    """Range, mean and spread of vectors that come in batches (Chan, Golub, LeVeque 1983)."""

    count: int = 0
    low: Any = None
    high: Any = None
    mean: Any = 0.0
    squares: Any = 0.0  # sum of squared distances from the mean

    def add(self, values: np.ndarray) -> None:
        """Take in (n, components) values; none may be NaN."""
        if not len(values):
            return
        values = values.astype(np.float64)
        mean = values.mean(axis=0)
        batch = Moments(
            count=len(values),
            low=values.min(axis=0),
            high=values.max(axis=0),
            mean=mean,
            squares=((values - mean) ** 2).sum(axis=0),
        )
        self.join(batch)

    def join(self, other: "Moments") -> None:
        """Take in all that another one has counted."""
        if not other.count:
            return
        total, shift = self.count + other.count, other.mean - self.mean
        self.low = other.low if self.count == 0 else np.minimum(self.low, other.low)
        self.high = other.high if self.count == 0 else np.maximum(self.high, other.high)
        between = shift**2 * (self.count * other.count / total)
        self.squares = self.squares + other.squares + between
        self.mean = self.mean + shift * (other.count / total)
        self.count = total

    def to_json(self) -> dict[str, list]:
        """LeRobot's form: lists of one number a component; the count is a list of one."""
        std = np.sqrt(self.squares / self.count)
        found = {"min": self.low, "max": self.high, "mean": self.mean, "std": std}
        return {**{name: value.tolist() for name, value in found.items()}, "count": [self.count]}


def table_features(tables: Mapping[str, pa.Table]) -> dict[str, dict[str, list]]:
    """`<table>/<column>` -> min, max, mean, std, count, from the derived tables."""
    found = {}
    for table, columns in FEATURES.items():
        for column in columns:
            moments = Moments()
            moments.add(_matrix(tables[table][column]))
            if moments.count:
                found[f"{table}/{column}"] = moments.to_json()
    return found


def topology_name(num_components: int, genus: Sequence[int] | None) -> str:
    """`c=2 g=0,1`: components, and the genus of each, sorted."""
    return f"c={num_components} g={','.join(map(str, sorted(genus or ())))}"


def topology_statistics(tables: Mapping[str, pa.Table]) -> dict[str, dict[str, Any]]:
    """Family -> scenes, how they end, events, shares of ambiguous and of differing frames."""
    scenes, frames = tables["scenes"], tables["frames"]
    frames = frames.filter(frames["num_components"].is_valid())
    indices = scenes["scene_index"].to_numpy()
    families, family = np.unique(np.array(scenes["family"].to_pylist(), str), return_inverse=True)
    names: dict[str, int] = {}  # topology -> its number below
    found = _topologies(frames["num_components"], frames["genus"], names)
    static = _topologies(frames["static_num_components"], frames["static_genus"], names)
    ambiguous = frames["ambiguous"].to_numpy()
    scene = frames["scene_index"].to_numpy()
    of_frame = family[np.searchsorted(indices, scene)]
    events = tables["topology_events"]
    of_event = family[np.searchsorted(indices, events["scene_index"].to_numpy())]
    kinds = np.array(events["kind"].to_pylist(), object)
    result = {}
    for number, name in enumerate(families.tolist()):
        own = of_frame == number
        if own.any():
            counted = Counter(kinds[of_event == number].tolist())
            result[name] = _family(
                scene[own], found[own], static[own], ambiguous[own], list(names), counted
            )
    return result


def dataset_sizes(info: Mapping[str, Any], tables: Mapping[str, pa.Table]) -> dict[str, Any]:
    """Scenes a split and family, key frames, views, layers."""
    scenes, views = tables["scenes"], tables["views"]
    layers = views["layer"].value_counts().to_pylist()
    kinds = Counter(zip(scenes["family"].to_pylist(), scenes["split"].to_pylist(), strict=True))
    return {
        "scenes": len(scenes),
        "frames": len(tables["frames"]),
        "views": {entry["values"]: entry["counts"] for entry in sorted(layers, key=str)},
        "failed": info["total_failed"],
        "scenes_by_family_and_split": {
            f"{family}/{split}": n for (family, split), n in sorted(kinds.items())
        },
        "layers": list(info["layers"]),
    }


def _matrix(column: pa.ChunkedArray) -> np.ndarray:
    """(n, components) numbers of a column: fixed lists have their length, others are flattened."""
    whole = column.drop_null().combine_chunks()
    if pa.types.is_fixed_size_list(column.type):
        return whole.flatten().to_numpy().reshape(-1, column.type.list_size)
    if pa.types.is_list(column.type):
        whole = whole.flatten()
    return whole.to_numpy().reshape(-1, 1)


def _topologies(
    counts: pa.ChunkedArray, genus: pa.ChunkedArray, names: dict[str, int]
) -> np.ndarray:
    """Number of each row's `topology_name`; names that are new get the next number."""
    lists = genus.combine_chunks()
    values, offsets = lists.flatten().to_numpy(), lists.offsets.to_numpy()
    starts, lengths = offsets[:-1] - offsets[0], np.diff(offsets)
    components = counts.to_numpy()
    numbers = np.zeros(len(components), np.int64)
    for length in np.unique(lengths):  # few, so that each is one matrix
        rows = np.flatnonzero(lengths == length)
        own = np.sort(values[starts[rows, None] + np.arange(length)], axis=1)
        keys = np.column_stack([components[rows], own])
        unique, place = np.unique(keys, axis=0, return_inverse=True)
        texts = [topology_name(count, rest) for count, *rest in unique.tolist()]
        known = np.array([names.setdefault(text, len(names)) for text in texts])
        numbers[rows] = known[place.ravel()]
    return numbers


def _family(
    scene: np.ndarray,
    found: np.ndarray,
    static: np.ndarray,
    ambiguous: np.ndarray,
    names: Sequence[str],
    events: Counter[str],
) -> dict[str, Any]:
    """Counts over the frames of one family, which are sorted by scene and time."""
    first = np.flatnonzero(np.r_[True, scene[1:] != scene[:-1]])
    last = np.r_[first[1:], len(scene)] - 1
    final = Counter(names[number] for number in found[last])
    differs, doubt = found != static, ambiguous.astype(bool)
    return {
        "scenes": len(last),
        "changed": int(np.count_nonzero(found[first] != found[last])),
        "final": dict(final.most_common()),
        "final_share": {name: n / len(last) for name, n in final.most_common()},
        "events": dict(events.most_common()),
        "ambiguous": float(doubt.mean()),
        "ambiguous_final": float(doubt[last].mean()),
        "static_differs": float(differs.mean()),
        "static_differs_final": float(differs[last].mean()),
    }
