"""Genus and scene graph of every component in every key frame.

A genus is the number of loops that last while balls around the particles grow (`readings.py`). It
is read at few key frames, more closely where two readings differ, or where something was merged or
cut; in between, solids are looked at. A change must last for four key frames or to the end of the
scene. The genus falls with its readings: a cut takes handles away, and holes close. It grows only
by what was merged within one piece, as none comes from nothing, and where a reading is firm (one
value, also for holes a little smaller or larger) or leaves no room for the genus before. A key
frame is unsure if its readings exclude its genus; handles that only holes of some sizes show and no
merge explains do not.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8
from scipy.spatial import KDTree

from doughdata.topology.readings import LoopWindow, Reading, read_component, solid_with
from doughdata.topology.runs import refine, runs_of
from doughdata.topology.skeletons import Skeleton, cycle_rank, skeleton_of, without_small_cycles
from doughdata.topology.solids import Closing, Solid, solid_genus
from doughschemas import SceneGraph

__all__ = ["Shape", "read_shapes", "scene_graph"]

STILL = 0.1  # [spacings]; a component that moved less than this keeps its shape
RETHIN = 4.0  # [spacings]; a component that moved more than this gets a new skeleton
FLICKER = 4  # key frames; a shorter change is smoothed
CROSSING = 12  # key frames between two looks that agree while fingers only cross particles
LOOK = 1.75  # [spacings], of the closing that is looked at between two readings


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Genus and graph of one component in one key frame."""

    genus: int
    sure: bool  # the readings around do not exclude it, and the graph has it
    nodes: Float64[np.ndarray, "nodes 3"]  # [m], world
    skeleton: Skeleton  # its edges join the nodes
    parted: bool = False  # a loop is open only because unmerged contacts are kept open


@dataclass(frozen=True, slots=True)
class _Thinned:
    """A component's skeleton with its number of cycles."""

    skeleton: Skeleton
    rank: int
    clear: bool  # whether it was clear which cycles to keep

    @classmethod
    def of(cls, solid: Solid, genus: int) -> "_Thinned":
        """Thin a solid to a graph of at most so many cycles."""
        skeleton, clear = without_small_cycles(skeleton_of(solid), genus)
        return cls(skeleton, cycle_rank(len(skeleton.positions), skeleton.edges), clear)

    def has(self, genus: int) -> bool:
        """Whether it shows this genus, clearly."""
        return self.clear and self.rank == genus


NOT_YET = _Thinned(
    Skeleton(positions=np.zeros((0, 3)), edges=np.zeros((0, 2), np.int32)), rank=-1, clear=False
)


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
        loops: Sequence[int],
        changed: Sequence[bool],
        crossed: Sequence[bool],
        spacing: float,
        window: LoopWindow,
    ) -> None:
        self.label, self.first, self.members = label, first, members
        self.last = first + len(members) - 1
        self.positions, self.spacing, self.window = positions, spacing, window
        self.bonds, self.contacts = bonds, contacts
        self.loops, self.changed, self.crossed = loops, changed, crossed
        self.readings: dict[int, Reading] = {}
        self.looks: dict[int, tuple[int, Solid]] = {}  # genus and solid at key frames not read

    def shapes(self) -> list[Shape]:
        """The shape in every key frame of the track."""
        refine(
            self.first,
            self.last,
            lambda frame: self._read(frame).range,
            self._settled,
            lambda low, high: [k for k in range(low + 1, high + 1) if self.changed[k]],
        )
        genus, steady = self._settle()
        return self._shapes(genus, steady)

    def _settled(self, low: int, high: int) -> bool:
        """Whether no test changed anything between two key frames, or nothing moved.

        What touches without being merged changes nothing. A finger may go through a tube, which
        then stays open: that is looked for, but not in every gap that would find a merge.
        """
        if self._moved(low, high) < STILL:
            return True
        since = slice(low + 1, high + 1)
        if any(self.changed[since]):
            return False
        if not any(self.crossed[since]):
            return True
        expected = self._read(low).genus
        steps = -(-(high - low) // CROSSING)
        between = (low + (high - low) * k // steps for k in range(1, steps))
        return all(self._looks_like(frame, expected) for frame in between)

    def _looks_like(self, frame: int, genus: int) -> bool:
        """Whether a solid of the component, with nothing kept open, has this genus.

        Cheaper than a reading, and enough where the readings before and after agree.
        """
        x = self._at(frame, self.members[frame - self.first])
        solid = Closing(x, self.spacing, largest=LOOK).solid(LOOK)
        if solid_genus(solid.inside) != genus:
            return False
        self.looks[frame] = genus, solid
        return True

    def _at(self, frame: int, members: Int64[np.ndarray, " _"]) -> Float64[np.ndarray, "_ 3"]:
        return np.asarray(self.positions[frame][members], dtype=np.float64)

    def _read(self, frame: int) -> Reading:
        if frame not in self.readings:
            members = self.members[frame - self.first]
            inside = np.zeros(self.positions.shape[1], dtype=bool)
            inside[members] = True
            bonds, contacts = (
                np.searchsorted(members, pairs[inside[pairs].all(axis=1)])
                for pairs in (self.bonds[frame], self.contacts[frame])
            )
            self.readings[frame] = read_component(
                self._at(frame, members), bonds, contacts, self.spacing, self.window
            )
        return self.readings[frame]

    def _moved(self, low: int, high: int) -> float:
        """Largest step [spacings] of a particle along one axis between two key frames."""
        members = self.members[0]
        step = np.abs(self.positions[high][members] - self.positions[low][members])
        return float(step.max()) / self.spacing

    def _settle(self) -> tuple[list[int], list[bool]]:
        """Genus of every key frame after weighing changes, and whether it is sure."""
        known = sorted(self.readings)
        frames = np.arange(self.first, self.last + 1)
        before = np.searchsorted(known, frames, side="right") - 1
        after = np.minimum(before + 1, len(known) - 1)
        genus = [self.readings[known[k]].genus for k in before]
        settled = self._weighed(genus)
        sure = [
            self._fits(known[a], value) and (known[a] == frame or self._fits(known[b], value))
            for a, b, frame, value in zip(before, after, frames.tolist(), settled, strict=True)
        ]
        return settled, sure

    def _weighed(self, genus: list[int]) -> list[int]:
        """What is read in every key frame, less what does not last or no merge explains."""
        value, left = self._at_first(genus), list(self.loops)
        settled: list[int] = []
        while (low := len(settled)) < len(genus):
            side = np.sign(np.array(genus[low:]) - value)
            high = low + int(np.argmax(np.r_[side != side[0], True]))
            more = 0
            if side[0] > 0 and self._lasts(low, high):
                more = self._grown(low, high, value, left)
            elif side[0] < 0 and self._lasts(low, high):
                more = max(genus[low:high]) - value
            value += more
            settled += [] if more else [value] * (high - low)
        return settled

    def _at_first(self, genus: list[int]) -> int:
        """Least genus up to the first that is read firmly and lasts."""
        edges = [0, *(k for k in range(1, len(genus)) if genus[k] != genus[k - 1]), len(genus)]
        for low, high in itertools.pairwise(edges):
            if self._lasts(low, high) and any(r.firm for r in self._between(low, high)):
                return min(genus[:high])
        return min(genus)

    def _lasts(self, low: int, high: int) -> bool:
        """Whether a span is no flicker; after the last key frames none come to judge them."""
        return high - low >= FLICKER or self.first + high == len(self.positions)

    def _grown(self, low: int, high: int, value: int, left: list[int]) -> int:
        """By how much the genus grows in a span above it; takes that from the merges `left`."""
        readings = self._between(low, high)
        excluded = all(not reading.floor <= value <= reading.ceiling for reading in readings)
        if not excluded and not any(reading.firm for reading in readings):
            return 0
        wanted = min(reading.genus for reading in readings) - value
        if low == 0:
            return wanted
        taken = 0
        for frame in range(max(self.first + low - FLICKER, 0), self.first + high):
            taken += (now := min(left[frame], wanted - taken))
            left[frame] -= now
        return taken

    def _fits(self, frame: int, genus: int) -> bool:
        """Whether the reading of a key frame leaves this genus possible.

        More handles than merges explain, not seen for all sizes of holes, are pores and creases.
        """
        reading = self.readings[frame]
        if reading.lowest <= genus <= reading.highest:
            return True
        return reading.floor == genus >= self._explained(frame)

    def _explained(self, frame: int) -> int:
        """Most handles that a firm reading before and the merges within one piece since explain."""
        firm = {f: r.genus for f, r in self.readings.items() if r.firm and f <= frame}
        if not firm:
            firm = {self.first: self.readings[frame].floor}
        until = frame + FLICKER  # a handle may be read a little before or after its merge
        return min(g + sum(self.loops[max(f - FLICKER, 0) : until]) for f, g in firm.items())

    def _between(self, low: int, high: int) -> list[Reading]:
        frames = range(self.first + low, self.first + high)
        return [self.readings[frame] for frame in frames if frame in self.readings]

    def _shapes(self, genus: list[int], sure: list[bool]) -> list[Shape]:
        shapes: list[Shape] = []
        made, thin = -1, NOT_YET
        anchor = node = np.zeros(0, np.int64)
        start = np.zeros((0, 3))
        for offset, frame in enumerate(range(self.first, self.last + 1)):
            wanted, reading = genus[offset], self.readings.get(frame)
            known, poor = self._known(frame) == wanted, not thin.has(wanted)
            stale = known and self._moved(made, frame) > RETHIN if made >= 0 else True
            if stale or (poor and (known or frame in self.readings)):
                of = self._nearest(frame, wanted) if made < 0 else frame
                new = _Thinned.of(self._solid(of, wanted), wanted)
                shown = new.rank == wanted
                if new.has(wanted) or (poor and (shown or known or made < 0)):
                    made, thin = frame, new
                    anchor, start = self.members[offset], self._at(frame, self.members[offset])
                    node = np.asarray(KDTree(thin.skeleton.positions).query(start)[1])
            nodes = thin.skeleton.positions
            moved = _node_shift(node, self._at(frame, anchor) - start, len(nodes))
            shapes.append(
                Shape(
                    genus=thin.rank,  # the record's graph and genus agree, sure or not
                    sure=sure[offset] and thin.has(wanted),
                    nodes=nodes + moved,
                    skeleton=thin.skeleton,
                    parted=reading is not None and reading.parted,
                )
            )
        return shapes

    def _known(self, frame: int) -> int | None:
        """Genus that was read or looked at in a key frame."""
        if frame in self.readings:
            return self.readings[frame].genus
        return self.looks[frame][0] if frame in self.looks else None

    def _nearest(self, frame: int, genus: int) -> int:
        """The nearest key frame that is known to have this genus, or was read."""
        near = [f for f in (*self.readings, *self.looks) if self._known(f) == genus]
        return min(near or self.readings, key=lambda f: (abs(f - frame), f))

    def _solid(self, frame: int, genus: int) -> Solid:
        """The solid of a key frame that was read, if it can with this genus, or looked at."""
        if frame not in self.readings:
            return self.looks[frame][1]
        x = self._at(frame, self.members[frame - self.first])
        return solid_with(x, self.readings[frame].walls, self.spacing, genus)


def read_shapes(
    positions: Float32[np.ndarray, "frames particles 3"],
    labels: Sequence[UInt8[np.ndarray, " particles"]],
    bonds: Sequence[Int64[np.ndarray, "_ 2"]],
    contacts: Sequence[Int64[np.ndarray, "_ 2"]],
    *,
    loops: Sequence[int],
    changed: Sequence[bool],
    crossed: Sequence[bool],
    spacing: float,
    window: LoopWindow,
) -> list[list[Shape]]:
    """Shapes of every key frame, in the order of the labels.

    Components stay open along `contacts` (unmerged near pairs) unless their sides join nearby by
    `bonds` (short ones). `loops` counts the merges within one piece in each key frame, `changed`
    tells those in which a test merged or cut something, `crossed` those in which a finger came
    between particles.
    """
    found: list[list[Shape]] = [[] for _ in labels]
    for label, first, members in runs_of(labels):
        track = _Track(
            label,
            first,
            members,
            positions,
            bonds,
            contacts,
            loops=loops,
            changed=changed,
            crossed=crossed,
            spacing=spacing,
            window=window,
        )
        for offset, shape in enumerate(track.shapes()):
            found[first + offset].append(shape)
    return found


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
