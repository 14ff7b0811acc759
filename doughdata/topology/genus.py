"""Genus and scene graph of every component in every key frame, from its solid.

A genus is read at few key frames and only looked at more closely where two readings differ. A
change that lasts for one or two key frames is a flicker: it is smoothed and marked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from doughschemas import SceneGraph
from jaxtyping import Float32, Float64, Int64, UInt8
from scipy.spatial import cKDTree

from doughdata.topology.skeletons import Skeleton, cycle_rank, skeleton_of
from doughdata.topology.solids import Solid, solid_genus, solids_of
from doughdata.topology.tracking import count_labels

__all__ = ["Shape", "read_shapes", "scene_graph"]

STILL = 0.1  # [spacings]; a component that moved less than this keeps its shape
RETHIN = 2.0  # [spacings]; a component that moved more than this gets a new skeleton
STRIDE = 4  # key frames between two readings that agree
FLICKER = 3  # key frames; a shorter change is smoothed
SAME = 0.02  # share of particles that a component may lose or win and be the same
NODE_LENGTH = 0.008  # [m], between nodes of a graph
SPUR = 0.008  # [m], branches that end sooner are no branches


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Genus and graph of one component in one key frame."""

    genus: int
    sure: bool  # all closing radii agree and the genus is no flicker
    skeleton: Skeleton  # where it was made
    moved: Float64[np.ndarray, "nodes 3"]  # [m], nodes in this key frame


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What was read from the solids of one component in one key frame."""

    genus: int
    sure: bool
    solid: Solid


@dataclass(slots=True, kw_only=True)
class _Track:
    """One component while it stays the same, key frames `first` .. `first + len(members) - 1`."""

    label: int
    first: int
    members: list[Int64[np.ndarray, " _"]]
    readings: dict[int, _Reading] = field(default_factory=dict)

    @property
    def last(self) -> int:
        return self.first + len(self.members) - 1


def read_shapes(
    positions: Float32[np.ndarray, "frames particles 3"],
    labels: Sequence[UInt8[np.ndarray, " particles"]],
    walls: Sequence[Int64[np.ndarray, "_ 2"]],
    *,
    spacing: float,
    radii: tuple[float, ...],
) -> list[list[Shape]]:
    """Shapes per key frame, in the order of the labels.

    `walls` are the unmerged pairs along which solids stay open; the first of `radii` [spacings]
    gives the genus, the others say whether it is sure.
    """
    shapes: list[dict[int, Shape]] = [{} for _ in labels]
    for track in _tracks(labels):

        def read(frame: int, track: _Track = track) -> _Reading:
            if frame not in track.readings:
                members = track.members[frame - track.first]
                own = walls[frame][(labels[frame][walls[frame]] == track.label).all(axis=1)]
                x = np.asarray(positions[frame], dtype=np.float64)[members]
                track.readings[frame] = _read(x, np.searchsorted(members, own), spacing, radii)
            return track.readings[frame]

        def still(low: int, high: int, track: _Track = track) -> bool:
            members = track.members[0]
            moved = np.abs(positions[low][members] - positions[high][members]).max()
            return bool(moved < STILL * spacing)

        _refine(track.first, track.last, read, still)
        genus, sure = _settle(track)
        skeletons = _skeletons(track, genus, positions, spacing)
        for offset, frame in enumerate(range(track.first, track.last + 1)):
            skeleton, moved, exact = skeletons[offset]
            shapes[frame][track.label] = Shape(
                genus=genus[offset], sure=sure[offset] and exact, skeleton=skeleton, moved=moved
            )
    return [[found[k] for k in sorted(found)] for found in shapes]
