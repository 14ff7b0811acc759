"""The causal pass: carry the bond graph through the key frames and decide merges and splits."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8
from scipy.spatial import KDTree

from doughdata.stages import PullApart
from doughdata.topology.bonds import BondGraph
from doughdata.topology.bridges import weak_bridges
from doughdata.topology.crops import SIDE_BOND
from doughdata.topology.decisions import UNSURE, Answers, Decision, Question
from doughdata.topology.fingers import Gripper, gripper_at
from doughdata.topology.merges import Patch, merge_patches
from doughdata.topology.pairs import connected, encode, is_member
from doughdata.topology.pulls import PullTest, disjoint_paths, make_test, run_tests
from doughdata.topology.splits import Neck, compression, split_necks
from doughdata.topology.tracking import crumb_limit
from doughschemas import Particles, Scene

if TYPE_CHECKING:
    from doughdata.topology.dynamic import DynamicConfig

__all__ = ["FrameState", "History"]

STILL = 0.1  # [spacings]; where all moved less since the graph was made nothing can have changed


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameState:
    """What the causal pass knows of one key frame."""

    pieces: Int32[np.ndarray, " particles"]
    contacts: Int64[np.ndarray, "contacts 2"]  # unmerged near pairs
    decisions: tuple[Decision, ...]
    bonds: Int64[np.ndarray, " bonds"]  # keys of the short ones
    touching: Int32[np.ndarray, " particles"]  # pieces of the static check: near is one
    loops: int = 0  # merges within one piece: only these make handles
    crossed: bool = False  # a finger has come between particles

    @property
    def changed(self) -> bool:
        """Whether a test merged or cut something."""
        return any(decision.passed for decision in self.decisions)


@dataclass(slots=True)
class History:
    """State carried from key frame to key frame."""

    scene: Scene
    particles: Particles
    config: "DynamicConfig"
    puller: PullApart | None
    graph: BondGraph
    crumb: float  # particles; a smaller piece is a crumb
    answers: Answers
    loops: int = 0  # merges within one piece in the present key frame
    action: int = 0
    last: FrameState | None = None

    @classmethod
    def start(
        cls, scene: Scene, particles: Particles, config: "DynamicConfig", puller: PullApart | None
    ) -> "History":
        """Before the first key frame: every body is one piece if its particles are near."""
        graph = BondGraph(
            np.asarray(particles.positions[0], dtype=np.float64),
            particles.object_ids,
            particles.spacing,
            reach=config.reach,
            link=config.link,
            start=config.start,
            support_new=config.support_new,
            support_old=config.support_old,
        )
        crumb = crumb_limit(particles, config.crumb_share, config.crumb_volume)
        return cls(
            scene=scene,
            particles=particles,
            config=config,
            puller=puller,
            graph=graph,
            crumb=crumb,
            answers=Answers(config=config),
        )

    def step(self, frame: int) -> FrameState:
        """Advance to a key frame and decide."""
        poses = self.particles.tool_poses
        started = False
        if int(poses.action[frame]) != self.action:
            self.action = int(poses.action[frame])
            self.answers.standing = []
            started = True
        self.answers.made, self.loops = [], 0
        x = np.asarray(self.particles.positions[frame], dtype=np.float64)
        if self.last is not None and not started and self._still(x):
            return replace(self.last, decisions=(), loops=0, crossed=False)
        if frame > 0:
            self.graph.advance(x)
        if started:
            self._start_action()
        gripper = gripper_at(self.scene, poses, frame)
        crossed = len(self.graph.crossed)
        self._cross(gripper)
        self._split(gripper)
        self._part()
        self._merge()
        self.last = self._state(crossed=len(self.graph.crossed) > crossed)
        return self.last

    def _still(self, x: Float64[np.ndarray, "particles 3"]) -> bool:
        """Whether nothing has moved since the graph was last advanced."""
        moved = float(np.abs(x - self.graph.positions).max())
        return moved < STILL * self.graph.spacing

    def _start_action(self) -> None:
        """Unlock what was cut. It stays apart until it is pressed closer than it lies now."""
        self.graph.start_action()
        for patch in self._patches():
            self.answers.decide(
                _about_patch(patch), 0.0, passed=False, threshold=self.config.merged_paths
            )

    def _patches(self) -> list[Patch]:
        config = self.config
        return merge_patches(
            self.graph,
            gap=config.patch_gap,
            nearest=max(config.test_gap, config.seam_gap),
            link=config.patch_link,
            length=config.patch_length,
            radius=config.crop,
            seam_gap=config.seam_gap,
            settled=self.answers.settled,
        )

    def _cross(self, gripper: Gripper) -> None:
        """Break bonds through a finger: a rigid body is between their ends."""
        graph, s = self.graph, self.graph.spacing
        reach = graph.reach * s / 2
        depth = self.config.finger_depth * s
        distance = gripper.distances_within(graph.positions, reach, raised=2 * depth)
        close = np.asarray((distance < reach).any(axis=0))
        if not close.any():
            return
        rows = np.flatnonzero(close.take(graph.pairs[:, 0]) & close.take(graph.pairs[:, 1]))
        rows = rows[~is_member(graph.near[rows], graph.crossed)]
        pairs = graph.pairs[rows]
        through = gripper.between(
            graph.positions[pairs[:, 0]],
            graph.positions[pairs[:, 1]],
            depth,
            distances=distance[:, pairs],
        )
        if through.any():
            graph.cross(rows[through])

    def _split(self, gripper: Gripper) -> None:
        config, graph = self.config, self.graph
        necks = split_necks(graph, gripper, radius=config.crop, gate=config.neck_gate)
        necks = [n for n in necks if not self.answers.settled(_about_neck(n, graph.spacing))]
        tests = [self._neck_test(neck, gripper) for neck in necks]
        for neck, test, pulled in zip(necks, tests, run_tests(tests, self.puller), strict=True):
            # Particles piled up in a narrow gap are more paths than the dough there is worth.
            core = graph.positions[neck.core]
            pressed = compression(core, graph.spacing, gripper, neck.opening)
            paths = self._paths(pulled, test) / pressed
            parted = paths < config.split_paths
            # A film thinner than a spacing is not resolved: that it holds is the less sure.
            self.answers.decide(
                _about_neck(neck, graph.spacing),
                paths,
                passed=bool(parted),
                threshold=config.split_paths,
                sharpness=1.0 if parted else min(1.0, neck.opening / graph.spacing),
            )
            if parted:
                graph.cut(self._cut_sides(pulled, test))

    def _part(self) -> None:
        """Cut what hangs together by next to nothing, wherever the fingers are."""
        if not (len(self.graph.crossed) or self.graph.cuts):
            return  # no finger has come between anything yet
        weakest = self.config.split_paths
        # A bridge that is a little too strong to be cut is still worth a doubt.
        for bridge in weak_bridges(self.graph, smallest=self.crumb, weakest=(1 + UNSURE) * weakest):
            parted = bridge.paths < weakest
            about = Question(kind="split", centre=bridge.centre, size=bridge.size, gap=0.0)
            self.answers.decide(
                about, float(bridge.paths), passed=parted, threshold=weakest, stands=False
            )
            if parted:
                self.graph.cut(bridge.side)

    def _neck_test(self, neck: Neck, gripper: Gripper) -> PullTest:
        return make_test(
            self.graph.positions,
            first=neck.first,
            second=neck.second,
            core=np.union1d(neck.core, neck.around),
            direction=gripper.lateral,
            near=neck.core,
            **self._pull_settings(),
        )

    def _pull_settings(self) -> dict[str, Any]:
        config = self.config
        return {
            "handle": config.handle,
            "distance": config.pull_distance,
            "speed": config.pull_speed,
            "spacing": self.graph.spacing,
            "material": self.scene.material,
        }

    def _paths(self, positions: Float64[np.ndarray, "crop 3"], test: PullTest) -> float:
        radius = (1 + self.config.path_gap) * self.graph.spacing
        return float(disjoint_paths(positions, test.first, test.second, radius))

    def _cut_sides(
        self, pulled: Float64[np.ndarray, "crop 3"], test: PullTest
    ) -> UInt8[np.ndarray, " particles"]:
        """Side 1 or 2 of every particle of the crop: the end that it stays with."""
        near = KDTree(pulled)
        radius = (1 + self.config.path_gap) * self.graph.spacing
        while True:
            piece = connected(near.query_pairs(radius, output_type="ndarray"), len(pulled))
            held = [np.isin(piece, piece[end]) for end in (test.first, test.second)]
            if not (held[0] & held[1]).any():
                break
            radius *= 0.9
        own = held[0] + 2 * held[1]
        loose = np.flatnonzero((own == 0) | (own == 3))
        if len(loose):
            known = np.flatnonzero((own == 1) | (own == 2))
            own[loose] = own[known[KDTree(pulled[known]).query(pulled[loose])[1]]]
        side = np.zeros(self.graph.count, np.uint8)
        side[test.indices] = own
        return side

    def _merge(self) -> None:
        threshold = self.config.merged_paths
        asked, tests = [], []
        for patch in self._patches():
            if self.answers.settled(_about_patch(patch)):
                continue
            test = self._patch_test(patch)
            before = self._paths(test.problem.positions, test)
            if before < threshold:  # pulling only takes paths away
                self.answers.decide(_about_patch(patch), before, passed=False, threshold=threshold)
                continue
            asked.append(patch)
            tests.append(test)
        for patch, test, pulled in zip(asked, tests, run_tests(tests, self.puller), strict=True):
            paths = self._paths(pulled, test)
            merged = paths >= threshold
            self.answers.decide(_about_patch(patch), paths, passed=merged, threshold=threshold)
            if merged:
                self._join(patch)

    def _join(self, patch: Patch) -> None:
        """Bond a patch; a patch within one piece may close a loop."""
        graph = self.graph
        piece = graph.pieces()
        sides = [np.bincount(piece[side]).argmax() for side in (patch.first, patch.second)]
        self.loops += int(sides[0] == sides[1])
        graph.join(encode(patch.pairs, graph.count))

    def _patch_test(self, patch: Patch) -> PullTest:
        return make_test(
            self.graph.positions,
            first=patch.first,
            second=patch.second,
            core=patch.core,
            direction=patch.normal,
            near=patch.core,
            **self._pull_settings(),
        )

    def _state(self, *, crossed: bool) -> FrameState:
        graph = self.graph
        pieces = graph.pieces()
        return FrameState(
            pieces=pieces,
            contacts=graph.pairs[graph.contact],
            decisions=tuple(self.answers.made),
            bonds=graph.bonded_keys(SIDE_BOND),
            touching=graph.touching(self.config.static.radius),
            loops=self.loops,
            crossed=crossed,
        )


def _about_patch(patch: Patch) -> Question:
    return Question(kind="merge", centre=patch.centre, size=len(patch.pairs), gap=patch.gap)


def _about_neck(neck: Neck, spacing: float) -> Question:
    return Question(
        kind="split", centre=neck.centre, size=len(neck.core), gap=neck.opening / spacing
    )
