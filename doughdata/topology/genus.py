"""Genus and scene graph of every component in every key frame, from its solid.

A genus is read at few key frames and only looked at more closely where two readings differ. It
changes when a reading is firm and lasts for four key frames or to the end of the scene. Firm: the
same for all closing radii, and no higher than with the unmerged contacts closed, because a cut may
open a loop but an unmerged contact alone makes no handle. Else the genus before stays and the key
frames are marked.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8
from scipy.spatial import KDTree

from doughdata.topology.skeletons import Skeleton, cycle_rank, skeleton_of
from doughdata.topology.solids import Closing, Solid, solid_genus
from doughdata.topology.tracking import count_labels
from doughdata.topology.walls import find_walls
from doughschemas import SceneGraph

__all__ = ["Shape", "read_shapes", "scene_graph"]

STILL = 0.1  # [spacings]; a component that moved less than this keeps its shape
RETHIN = 2.0  # [spacings]; a component that moved more than this gets a new skeleton
STRIDE = 4  # key frames between two readings that agree
FLICKER = 4  # key frames; a shorter change is smoothed
SAME = 0.02  # share of particles that a component may lose or win and be the same


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Genus and graph of one component in one key frame."""

    genus: int
    sure: bool  # all closing radii agree, the genus is no flicker and the graph has it
    nodes: Float64[np.ndarray, "nodes 3"]  # [m], world
    skeleton: Skeleton  # its edges join the nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What was read from the solids of one component in one key frame."""

    genus: int
    sure: bool  # all closing radii agree
    firm: bool  # and no handle exists only because contacts are kept open: a cut opens loops
    solid: Solid


class _Track:
    """One component while it stays the same: key frames `first` to `last`."""

    def __init__(
        self,
        label: int,
        first: int,
        members: list[Int64[np.ndarray, " _"]],
        positions: Float32[np.ndarray, "frames particles 3"],
        bonds: Sequence[Int64[np.ndarray, "_ 2"]],
        contacts: Sequence[Int64[np.ndarray, "_ 2"]],
        *,
        spacing: float,
        radii: tuple[float, ...],
    ) -> None:
        self.label, self.first, self.members = label, first, members
        self.last = first + len(members) - 1
        self.positions, self.spacing, self.radii = positions, spacing, radii
        self.bonds, self.contacts = bonds, contacts
        self.readings: dict[int, _Reading] = {}

    def shapes(self) -> list[Shape]:
        """The shape in every key frame of the track."""
        self._refine(self.first, self.last)
        genus, steady = self._settle()
        return self._shapes(genus, steady)

    def _at(self, frame: int, members: Int64[np.ndarray, " _"]) -> Float64[np.ndarray, "_ 3"]:
        return np.asarray(self.positions[frame][members], dtype=np.float64)

    def _read(self, frame: int) -> _Reading:
        if frame not in self.readings:
            members = self.members[frame - self.first]
            inside = np.zeros(self.positions.shape[1], dtype=bool)
            inside[members] = True
            bonds, contacts = (
                np.searchsorted(members, pairs[inside[pairs].all(axis=1)])
                for pairs in (self.bonds[frame], self.contacts[frame])
            )
            x = self._at(frame, members)
            closing = Closing(x, self.spacing, largest=max(self.radii))
            solids = [closing.solid(radius) for radius in self.radii]
            walls = find_walls(
                x,
                bonds,
                contacts,
                closing.gaps(solids[int(np.argmax(self.radii))]),
                spacing=self.spacing,
                voxel=closing.size,
                widest=2 * max(self.radii) * self.spacing,
            )
            closed = solids[0]
            solids = [closing.opened(solid, walls) for solid in solids]
            genus = [solid_genus(solid.inside) for solid in solids]
            sure = len(set(genus)) == 1
            self.readings[frame] = _Reading(
                genus=genus[0],
                sure=sure,
                firm=sure and genus[0] <= solid_genus(closed.inside),
                solid=solids[0],
            )
        return self.readings[frame]

    def _moved(self, low: int, high: int) -> float:
        """Largest step [spacings] of a particle along one axis between two key frames."""
        members = self.members[0]
        step = np.abs(self.positions[high][members] - self.positions[low][members])
        return float(step.max()) / self.spacing

    def _refine(self, low: int, high: int) -> None:
        """Read between two key frames until readings that agree are near."""
        same = self._read(low).genus == self._read(high).genus
        if high - low <= 1 or (same and (high - low <= STRIDE or self._moved(low, high) < STILL)):
            return
        middle = (low + high) // 2
        self._refine(low, middle)
        self._refine(middle, high)

    def _settle(self) -> tuple[list[int], list[bool]]:
        """Genus of every key frame after weighing changes, and whether it is sure."""
        known = sorted(self.readings)
        frames = np.arange(self.first, self.last + 1)
        before = np.searchsorted(known, frames, side="right") - 1
        after = np.minimum(before + 1, len(known) - 1)
        genus = [self.readings[known[k]].genus for k in before]
        sure = [
            self.readings[known[a]].sure and (self.readings[known[b]].sure or known[a] == f)
            for a, b, f in zip(before, after, frames.tolist(), strict=True)
        ]
        edges = [0, *(k for k in range(1, len(genus)) if genus[k] != genus[k - 1]), len(genus)]
        spans = [(low, high) for low, high in itertools.pairwise(edges)]
        kept = [genus[low] for low, high in spans if self._holds(low, high)]
        value = kept[0] if kept else min(genus)
        settled = []
        for low, high in spans:
            value = genus[low] if self._holds(low, high) else value
            settled += [value] * (high - low)
        sure = [s and read == value for s, read, value in zip(sure, genus, settled, strict=True)]
        return settled, sure

    def _holds(self, low: int, high: int) -> bool:
        """Whether a span of equal readings is firm somewhere, and no flicker."""
        # The last key frames of the scene have no later ones to judge them.
        ends = self.first + high == len(self.positions)
        readings = [self.readings.get(self.first + k) for k in range(low, high)]
        firm = any(reading is not None and reading.firm for reading in readings)
        return firm and (high - low >= FLICKER or ends)

    def _shapes(self, genus: list[int], sure: list[bool]) -> list[Shape]:
        shapes: list[Shape] = []
        made, skeleton = -1, None
        anchor = node = np.zeros(0, np.int64)
        start = np.zeros((0, 3))
        for offset, frame in enumerate(range(self.first, self.last + 1)):
            reading = self.readings.get(frame)
            fits = skeleton is not None and _rank(skeleton) == genus[offset]
            if skeleton is None or (
                reading is not None
                and (not fits or self._moved(made, frame) > RETHIN)
                and reading.genus == genus[offset]
            ):
                solid = self._solid_for(frame, genus[offset])
                skeleton, made = skeleton_of(solid), frame
                members = self.members[offset]
                anchor, start = members, self._at(frame, members)
                node = np.asarray(KDTree(skeleton.positions).query(start)[1])
            moved = _node_shift(node, self._at(frame, anchor) - start, len(skeleton.positions))
            shapes.append(
                Shape(
                    genus=_rank(skeleton),  # the record's graph and genus agree, sure or not
                    sure=sure[offset] and _rank(skeleton) == genus[offset],
                    nodes=skeleton.positions + moved,
                    skeleton=skeleton,
                )
            )
        return shapes

    def _solid_for(self, frame: int, genus: int) -> Solid:
        """The solid of a key frame, or of the nearest one read with this genus."""
        if frame in self.readings and self.readings[frame].genus == genus:
            return self.readings[frame].solid
        near = [f for f, r in self.readings.items() if r.genus == genus]
        return self.readings[min(near, key=lambda f: (abs(f - frame), f))].solid


def read_shapes(
    positions: Float32[np.ndarray, "frames particles 3"],
    labels: Sequence[UInt8[np.ndarray, " particles"]],
    bonds: Sequence[Int64[np.ndarray, "_ 2"]],
    contacts: Sequence[Int64[np.ndarray, "_ 2"]],
    *,
    spacing: float,
    radii: tuple[float, ...],
) -> list[list[Shape]]:
    """Shapes of every key frame, in the order of the labels.

    Solids stay open along `contacts` (unmerged near pairs) unless their sides join nearby by
    `bonds` (short ones). The first of `radii` [spacings] gives the genus, the others say whether it
    is sure.
    """
    found: list[list[Shape]] = [[] for _ in labels]
    for label, first, members in _runs(labels):
        track = _Track(
            label, first, members, positions, bonds, contacts, spacing=spacing, radii=radii
        )
        for offset, shape in enumerate(track.shapes()):
            found[first + offset].append(shape)
    return found


def _runs(
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


def _rank(skeleton: Skeleton) -> int:
    return cycle_rank(len(skeleton.positions), skeleton.edges)


def _node_shift(
    node: Int64[np.ndarray, " members"], moved: Float64[np.ndarray, "members 3"], count: int
) -> Float64[np.ndarray, "nodes 3"]:
    """Mean motion [m] of the particles nearest to each node."""
    shift = np.zeros((count, 3))
    np.add.at(shift, node, moved)
    return shift / np.maximum(np.bincount(node, minlength=count), 1)[:, None]


def scene_graph(
    positions: Float64[np.ndarray, "particles 3"],
    labels: UInt8[np.ndarray, " particles"],
    shapes: Sequence[Shape],
) -> SceneGraph:
    """Join the graphs of all components; a node stands for its component's nearest particles."""
    components, particles, edges, base = [], [], [], 0
    for k, shape in enumerate(shapes):
        number = len(shape.nodes)
        nearest = KDTree(shape.nodes).query(positions[labels == k])[1]
        components.append(np.full(number, k, np.uint8))
        particles.append(np.bincount(nearest, minlength=number).astype(np.int32))
        edges.append(shape.skeleton.edges + base)
        base += number
    return SceneGraph(
        positions=np.concatenate([shape.nodes for shape in shapes]).astype(np.float32),
        components=np.concatenate(components),
        particles=np.concatenate(particles),
        edges=np.concatenate(edges).astype(np.int32),
    )
