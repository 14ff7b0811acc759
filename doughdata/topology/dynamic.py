"""The dynamic check: two pieces are one if they stay together when pulled apart."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from doughdata.stages import PullApart
from doughdata.topology.doubts import timed_events, with_doubts
from doughdata.topology.genus import Shape, read_shapes, scene_graph
from doughdata.topology.history import FrameState, History
from doughdata.topology.pairs import decode
from doughdata.topology.readings import LoopWindow
from doughdata.topology.record import bond_changes
from doughdata.topology.static import StaticConfig, static_genus
from doughdata.topology.tracking import (
    components_of,
    crumb_limit,
    first_labels,
    next_labels,
)
from doughschemas import FrameTopology, Particles, Scene, Topology

__all__ = ["FILLED", "DynamicCheck", "DynamicConfig"]

FILLED = 3**0.5 / 2  # [spacings], radius at which balls around a cubic lattice leave no gap


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicConfig:
    """Thresholds of the dynamic check; lengths in particle spacings unless a unit is given.

    Chosen at 2 mm: on hand-made scenes, among them the half `tuning` of the truth table in
    `benchmarks/`, and those of loops on pinched rings with holes of 3 to 8 mm.
    """

    reach: float = 3.0  # pairs up to this long are bonded or in contact
    link: float = 2.5  # bonds up to this long hold a component together
    start: float = 1.5  # particles of a body this near are one piece at the start
    support_new: float = 0.25  # share of bonded common neighbours at which a new pair bonds
    support_old: float = 0.45  # the same for a contact pair
    finger_depth: float = 0.4  # a bond this deep inside a finger is cut
    patch_gap: float = 2.6  # contacts up to this long make up a patch
    test_gap: float = 1.7  # a wider patch misses a layer of particles: nothing to pull at
    patch_link: float = 2.2  # contact particles this near are one patch
    patch_length: float = 0.012  # [m], longest patch of one test
    seam_gap: float = 1.7  # a patch beside a merged seam joins it below this gap
    crop: float = 0.016  # [m], of particles around a patch that are pulled
    handle: float = 0.009  # [m] from the patch, beyond which particles are driven
    pull_distance: float = 0.004  # [m], each side
    pull_speed: float = 0.25  # [m/s], each side
    path_gap: float = 1.25  # widest, beside one spacing, that a step of a path crosses
    merged_paths: float = 5.0  # at least so many disjoint paths: one piece
    split_paths: float = 3.5  # fewer, in units of resting dough: parted
    neck_gate: float = 0.6  # of the thickness beside it, below which a neck is tested
    same_place: float = 0.004  # [m], between two tests of one patch
    grown: float = 1.3  # a patch is tested again when it has grown by this factor
    closer: float = 0.05  # or when its gap has closed by this much ...
    closer_far: float = 0.1  # ... and a neck far from the threshold by this share
    loop_birth: float = 1.0  # radius of balls around particles that close a hole's rim
    hole_radius: float = 0.684  # of a hole, beyond FILLED: 6 mm across at 2 mm spacing
    loop_doubt: float = 0.1  # a hole that other radii, so much off, do not have is unsure
    crumb_share: float = 0.02  # of all particles; a smaller piece is a crumb ...
    crumb_volume: float = 0.8e-6  # [m3] ... if it is also smaller than this
    static: StaticConfig = field(default_factory=StaticConfig)  # of the static check beside it


class DynamicCheck:
    """Topology from positions and tool poses, decided by pull tests.

    `pull_apart` runs the counterfactuals; without it, only scenes that need none can be checked.
    """

    def __init__(
        self, config: DynamicConfig | None = None, *, pull_apart: PullApart | None = None
    ) -> None:
        self.config = config or DynamicConfig()
        self.pull_apart = pull_apart

    def check(self, scene: Scene, particles: Particles) -> Topology:
        """Check every key frame, in order.

        Raises:
            BadInputError: a pull is needed and no `pull_apart` was handed in.
            SceneError: a tool's mesh cannot be used.
        """
        states = self.follow(scene, particles)
        labels = self.label(particles, states)
        shapes = self.read(particles, states, labels)
        frames = tuple(
            _frame(x, own, shape, state)
            for x, own, shape, state in zip(
                particles.positions, labels, shapes, states, strict=True
            )
        )
        events = timed_events(frames, shapes, states)
        static = static_genus(particles, [state.touching for state in states], self.config.static)
        made, broken = bond_changes([state.bonds for state in states], len(labels[0]))
        return Topology(
            frames=with_doubts(frames, shapes, states, events),
            events=tuple(events),
            static_num_components=np.array([len(own) for own in static], np.int32),
            static_genus=tuple(static),
            bonds_made=made,
            bonds_broken=broken,
        )

    def follow(self, scene: Scene, particles: Particles) -> list[FrameState]:
        """The causal pass: bonds, contacts and decisions of every key frame."""
        history = History.start(scene, particles, self.config, self.pull_apart)
        return [history.step(frame) for frame in range(len(particles.positions))]

    def label(
        self, particles: Particles, states: Sequence[FrameState]
    ) -> list[UInt8[np.ndarray, " particles"]]:
        """Component of every particle in every key frame."""
        crumb = crumb_limit(particles, self.config.crumb_share, self.config.crumb_volume)
        labels: list[UInt8[np.ndarray, " particles"]] = []
        for state, x in zip(states, particles.positions, strict=True):
            parts = components_of(state.pieces, crumb=crumb)
            if labels:
                labels.append(next_labels(parts, labels[-1], x))
            else:
                labels.append(first_labels(parts, x, particles.object_ids))
        return labels

    def read(
        self,
        particles: Particles,
        states: Sequence[FrameState],
        labels: Sequence[UInt8[np.ndarray, " particles"]],
    ) -> list[list[Shape]]:
        """Genus and graph of every component in every key frame, in the order of the labels."""
        return read_shapes(
            particles.positions,
            labels,
            [decode(state.bonds, len(particles.object_ids)) for state in states],
            [state.contacts for state in states],
            loops=[state.loops for state in states],
            changed=[state.changed for state in states],
            crossed=[state.crossed for state in states],
            spacing=particles.spacing,
            window=LoopWindow(
                birth=self.config.loop_birth,
                death=FILLED + self.config.hole_radius,
                doubt=self.config.loop_doubt,
            ),
        )


def _frame(
    x: np.ndarray, labels: UInt8[np.ndarray, " particles"], shapes: list[Shape], state: FrameState
) -> FrameTopology:
    return FrameTopology(
        labels=labels,
        genus=tuple(shape.genus for shape in shapes),
        graph=scene_graph(np.asarray(x, dtype=np.float64), labels, shapes),
        contacts=state.contacts.astype(np.int32),
    )
