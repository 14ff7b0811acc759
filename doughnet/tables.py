"""Rows of a table: metrics in percent, means over frames, intervals over scenes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from doughnet.intervals import bootstrap
from doughnet.metrics import TopologyScore

__all__ = ["Row", "Scenes", "Scored", "summary", "table_row", "with_steps"]

COLUMNS = ("viou", "ciou", "accc", "accg", "accg_components")
Row = dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """Metrics of one predicted frame, and the class of the true one."""

    score: TopologyScore
    topology: tuple[int, ...]  # true genera, sorted


Scenes = Sequence[Sequence[Scored]]  # frames of every scene


def summary(scored: Sequence[Scored]) -> Row:
    """Means over frames; `balanced_accg` is the mean over the topologies that occur."""
    return _Sums.of([[one] for one in scored]).means(np.ones(len(scored), np.int64))


def table_row(scenes: Scenes) -> dict[str, Any]:
    """Means over the frames of some scenes, and the 95 % interval of each over scenes."""
    scenes = [own for own in scenes if own]
    sums = _Sums.of(scenes)
    return {
        **sums.means(np.ones(len(scenes), np.int64)),
        "interval": bootstrap(len(scenes), sums.means),
    }


def with_steps(scenes: Scenes) -> dict[str, Any]:
    """A row as `table_row` gives, step by step (`by_step`) and scene by scene (`by_scene`) too."""
    steps = [[one for one in step if one is not None] for step in zip_longest(*scenes)]
    return {
        **table_row(scenes),
        "by_step": [summary(step) for step in steps],
        "by_scene": [summary(own) for own in scenes],
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sums:
    """What the means of any choice of scenes are made of."""

    frames: Int64[np.ndarray, " scenes"]
    metrics: Float64[np.ndarray, "scenes columns"]
    seen: Int64[np.ndarray, "scenes topologies"]  # frames of each true topology
    right: Int64[np.ndarray, "scenes topologies"]  # of them those with the right genera

    @classmethod
    def of(cls, scenes: Scenes) -> "_Sums":
        classes = {one.topology for one in chain.from_iterable(scenes)}
        place = {topology: k for k, topology in enumerate(sorted(classes))}
        sums = cls(
            frames=np.array([len(own) for own in scenes], np.int64),
            metrics=np.zeros((len(scenes), len(COLUMNS))),
            seen=np.zeros((len(scenes), len(place)), np.int64),
            right=np.zeros((len(scenes), len(place)), np.int64),
        )
        for k, own in enumerate(scenes):
            for one in own:
                sums.metrics[k] += _values(one.score)
                sums.seen[k, place[one.topology]] += 1
                sums.right[k, place[one.topology]] += one.score.right_genus
        return sums

    def means(self, times: Int64[np.ndarray, " scenes"]) -> Row:
        """The row of scenes that count so many times each."""
        frames = int(times @ self.frames)
        means = times @ self.metrics / max(frames, 1)
        seen = times @ self.seen
        shares = (times @ self.right)[seen > 0] / seen[seen > 0]
        balanced = float(shares.mean()) if len(shares) else 0.0
        row = dict(zip(COLUMNS, means.tolist(), strict=True)) | {"balanced_accg": balanced}
        return {name: round(100 * value, 2) for name, value in row.items()} | {"frames": frames}


def _values(score: TopologyScore) -> tuple[float, ...]:
    """In the order of `COLUMNS`."""
    return (
        score.volume_iou,
        score.component_iou,
        float(score.right_count),
        float(score.right_genus),
        score.genus_share,
    )
