"""The static check: what is near is one. The baseline beside the dynamic check."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8

from doughdata.topology.genus import Shape, scene_graph
from doughdata.topology.pairs import connected, decode, near_keys
from doughdata.topology.record import bond_changes
from doughdata.topology.runs import refine
from doughdata.topology.skeletons import cycle_rank, skeleton_of
from doughdata.topology.solids import Closing, Solid, solid_genus
from doughdata.topology.tracking import (
    components_of,
    crumb_limit,
    find_events,
    first_labels,
    next_labels,
)
from doughschemas import FrameTopology, Particles, Scene, Topology

__all__ = ["StaticCheck", "StaticConfig", "StaticFrame", "static_frames", "static_genus"]

STILL = 0.1  # [spacings]; a state that moved less than this keeps its reading
FINEST = 3  # key frames between two readings of the baseline that differ


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticConfig:
    """Thresholds of the static check; lengths in particle spacings unless a unit is given."""

    radius: float = 1.5  # particles this near are one piece; solids are closed with such balls
    crumb_share: float = 0.02  # of all particles; a smaller piece is a crumb ...
    crumb_volume: float = 0.8e-6  # [m3] ... if it is also smaller than this


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticFrame:
    """What the static check says of one key frame: components, largest first."""

    parts: list[Int32[np.ndarray, " _"]]
    solids: list[Solid]
    genus: tuple[int, ...]
    bonds: Int64[np.ndarray, " bonds"]  # keys of the near pairs


class StaticCheck:
    """Radius graph for the components, Euler characteristic of their solids for the genus.

    It cannot tell touching from merged; that is why it is only the baseline.
    """

    def __init__(self, config: StaticConfig | None = None) -> None:
        self.config = config or StaticConfig()

    def check(self, scene: Scene, particles: Particles) -> Topology:  # noqa: ARG002 - protocol
        """Check every key frame on its own; only labels are carried over, by shared particles."""
        read = static_frames(particles, self.config)
        frames: list[FrameTopology] = []
        for own, x in zip(read, np.asarray(particles.positions, np.float64), strict=True):
            labels = (
                next_labels(own.parts, frames[-1].labels, x)
                if frames
                else first_labels(own.parts, x, particles.object_ids)
            )
            frames.append(_frame(x, labels, own))
        made, broken = bond_changes([own.bonds for own in read], len(particles.object_ids))
        events = []
        for k in range(1, len(frames)):
            events += find_events(
                k, frames[k - 1], frames[k], cut=[True] * frames[k].num_components, margins={}
            )
        return Topology(
            frames=tuple(frames),
            events=tuple(events),
            static_num_components=np.array([len(own.genus) for own in read], np.int32),
            static_genus=tuple(own.genus for own in read),
            bonds_made=made,
            bonds_broken=broken,
        )


def static_frames(particles: Particles, config: StaticConfig) -> list[StaticFrame]:
    """Components and genus of every key frame from distances alone."""
    crumb = crumb_limit(particles, config.crumb_share, config.crumb_volume)
    found: list[StaticFrame] = []
    read_at = np.zeros(0)
    for x in np.asarray(particles.positions, np.float64):
        if found and np.abs(x - read_at).max() < STILL * particles.spacing:
            found.append(found[-1])
            continue
        bonds = near_keys(x, config.radius * particles.spacing)
        parts = components_of(connected(decode(bonds, len(x)), len(x)), crumb=crumb)
        solids = _solids(x, parts, particles.spacing, config.radius)
        genus = tuple(solid_genus(solid.inside) for solid in solids)
        found.append(StaticFrame(parts=parts, solids=solids, genus=genus, bonds=bonds))
        read_at = x
    return found


def static_genus(
    particles: Particles, pieces: Sequence[Int32[np.ndarray, " particles"]], config: StaticConfig
) -> list[tuple[int, ...]]:
    """Genus of every component of the static check in every key frame, largest component first.

    `pieces` are those of particles nearer than `config.radius`. Solids are read at least every
    `STRIDE` key frames in which anything moves, and every `FINEST` where two readings differ.
    """
    crumb = crumb_limit(particles, config.crumb_share, config.crumb_volume)
    parts = [components_of(piece, crumb=crumb) for piece in pieces]
    read: dict[int, tuple[int, ...]] = {}

    def genus(frame: int) -> tuple[int, ...]:
        if frame not in read:
            x = np.asarray(particles.positions[frame], np.float64)
            solids = _solids(x, parts[frame], particles.spacing, config.radius)
            read[frame] = tuple(solid_genus(solid.inside) for solid in solids)
        return read[frame]

    def still(low: int, high: int) -> bool:
        moved = np.abs(particles.positions[high] - particles.positions[low]).max()
        return bool(moved < STILL * particles.spacing)

    counts = [len(own) for own in parts]
    edges = [0, *(k for k in range(1, len(counts)) if counts[k] != counts[k - 1]), len(counts)]
    for first, end in itertools.pairwise(edges):
        refine(first, end - 1, genus, still, finest=FINEST)
    found: list[tuple[int, ...]] = []
    for frame in range(len(parts)):
        found.append(read.get(frame) or found[-1])
    return found


def _solids(
    x: Float64[np.ndarray, "particles 3"],
    parts: Sequence[Int32[np.ndarray, " _"]],
    spacing: float,
    radius: float,
) -> list[Solid]:
    return [Closing(x[part], spacing, largest=radius).solid(radius) for part in parts]


def _frame(
    x: Float64[np.ndarray, "particles 3"], labels: UInt8[np.ndarray, " particles"], own: StaticFrame
) -> FrameTopology:
    order = np.argsort([labels[part[0]] for part in own.parts])
    shapes = [_shape(own.solids[k], own.genus[k]) for k in order]
    return FrameTopology(
        labels=labels,
        genus=tuple(shape.genus for shape in shapes),
        graph=scene_graph(x, labels, shapes),
        contacts=np.zeros((0, 2), np.int32),
        ambiguous_reason=_doubt(shapes),
    )


def _shape(solid: Solid, genus: int) -> Shape:
    skeleton = skeleton_of(solid)
    exact = cycle_rank(len(skeleton.positions), skeleton.edges) == genus
    return Shape(genus=genus, sure=exact, nodes=skeleton.positions, skeleton=skeleton)


def _doubt(shapes: Sequence[Shape]) -> str:
    return "" if all(shape.sure for shape in shapes) else "the thinned graph has another genus"
