"""The causal pass: carry the bond graph through the key frames and decide merges and splits."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8
from scipy.spatial import KDTree

from doughdata.stages import PullApart
from doughdata.topology.bonds import BondGraph
from doughdata.topology.crops import SIDE_BOND
from doughdata.topology.fingers import Gripper, gripper_at
from doughdata.topology.merges import Patch, merge_patches
from doughdata.topology.pairs import connected, encode, is_member
from doughdata.topology.pulls import PullTest, disjoint_paths, make_test, run_tests
from doughdata.topology.splits import Neck, compression, split_necks
from doughschemas import Particles, Scene

if TYPE_CHECKING:
    from doughdata.topology.dynamic import DynamicConfig

__all__ = ["Decision", "FrameState", "History"]


STILL = 0.02  # [spacings]; in a key frame that moved less nothing can have changed


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """One answered question: does this patch hold, is this neck parted?"""

    kind: str  # merge | split
    centre: Float64[np.ndarray, " 3"]  # [m]
    size: int  # contact pairs of a patch, particles of a neck
    gap: float  # [spacings] of a patch, opening in spacings of a neck
    paths: float  # disjoint paths left; of a neck, in units of resting dough
    passed: bool
    margin: float  # distance of `paths` from the threshold, in units of the threshold


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameState:
    """What the causal pass knows of one key frame."""

    pieces: Int32[np.ndarray, " particles"]
    contacts: Int64[np.ndarray, "contacts 2"]  # unmerged near pairs
    decisions: tuple[Decision, ...]
    bonds: Int64[np.ndarray, " bonds"]  # keys of the short ones
    touching: Int32[np.ndarray, " particles"]  # pieces of the static check: near is one

    @property
    def joined(self) -> bool:
        """Whether something was merged."""
        return any(d.kind == "merge" and d.passed for d in self.decisions)


@dataclass(slots=True)
class History:
    """State carried from key frame to key frame."""

    scene: Scene
    particles: Particles
    config: "DynamicConfig"
    puller: PullApart | None
    graph: BondGraph
    decisions: list[Decision] = field(default_factory=list)  # of the present key frame
    standing: list[Decision] = field(default_factory=list)  # last answers, by place
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
        return cls(scene=scene, particles=particles, config=config, puller=puller, graph=graph)

    def step(self, frame: int) -> FrameState:
        """Advance to a key frame and decide."""
        poses = self.particles.tool_poses
        started = False
        if int(poses.action[frame]) != self.action:
            self.action = int(poses.action[frame])
            self.standing = []
            started = True
        self.decisions = []
        x = np.asarray(self.particles.positions[frame], dtype=np.float64)
        if self.last is not None and not started and self._still(x):
            return replace(self.last, decisions=())
        if frame > 0:
            self.graph.advance(x)
        if started:
            self._start_action()
        gripper = gripper_at(self.scene, poses, frame)
        self._cross(gripper)
        self._split(gripper)
        self._merge()
        self.last = self._state()
        return self.last

    def _still(self, x: Float64[np.ndarray, "particles 3"]) -> bool:
        """Whether nothing has moved since the graph was last advanced."""
        moved = float(np.abs(x - self.graph.positions).max())
        return moved < STILL * self.graph.spacing

    def _start_action(self) -> None:
        """Unlock what was cut. It stays apart until it is pressed closer than it lies now."""
        self.graph.start_action()
        for patch in self._patches():
            self._note(*_patch_key(patch), 0.0, False, self.config.merged_paths)

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
            settled=lambda centre, size, gap: self._settled("merge", centre, size, gap),
        )

    def _cross(self, gripper: Gripper) -> None:
        """Break bonds through a finger: a rigid body is between their ends."""
        graph, s = self.graph, self.graph.spacing
        reach = graph.reach * s / 2
        distance = gripper.distances_within(graph.positions, reach)
        close = np.asarray((distance < reach).any(axis=0))
        if not close.any():
            return
        rows = np.flatnonzero(close.take(graph.pairs[:, 0]) & close.take(graph.pairs[:, 1]))
        rows = rows[~is_member(graph.near[rows], graph.crossed)]
        pairs = graph.pairs[rows]
        through = gripper.between(
            graph.positions[pairs[:, 0]],
            graph.positions[pairs[:, 1]],
            self.config.finger_depth * s,
            distances=distance[:, pairs],
        )
        if through.any():
            graph.cross(rows[through])

    def _split(self, gripper: Gripper) -> None:
        config, graph = self.config, self.graph
        necks = split_necks(graph, gripper, radius=config.crop, gate=config.neck_gate)
        asked = [neck for neck in necks if not self._settled(*_neck_key(neck, graph.spacing))]
        tests = [self._neck_test(neck, gripper) for neck in asked]
        for neck, test, pulled in zip(asked, tests, run_tests(tests, self.puller), strict=True):
            # Particles piled up in a narrow gap are more paths than the dough there is worth.
            core = graph.positions[neck.core]
            pressed = compression(core, graph.spacing, gripper, neck.opening)
            paths = self._paths(pulled, test) / pressed
            parted = paths < config.split_paths
            self._note(*_neck_key(neck, graph.spacing), paths, parted, config.split_paths)
            if parted:
                graph.cut(self._cut_sides(pulled, test))

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

    def _pull_settings(self) -> dict[str, float]:
        config = self.config
        return {
            "handle": config.handle,
            "distance": config.pull_distance,
            "speed": config.pull_speed,
            "spacing": self.graph.spacing,
        }

    def _paths(self, positions: Float64[np.ndarray, "crop 3"], test: PullTest) -> int:
        radius = self.config.path_radius * self.graph.spacing
        return disjoint_paths(positions, test.first, test.second, radius)

    def _cut_sides(
        self, pulled: Float64[np.ndarray, "crop 3"], test: PullTest
    ) -> UInt8[np.ndarray, " particles"]:
        """Side 1 or 2 of every particle of the crop: the end that it stays with."""
        near = KDTree(pulled)
        radius = self.config.path_radius * self.graph.spacing
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
        config, graph = self.config, self.graph
        asked, tests = [], []
        for patch in self._patches():
            if self._settled(*_patch_key(patch)):
                continue
            test = self._patch_test(patch)
            before = self._paths(test.problem.positions, test)
            if before < config.merged_paths:  # pulling only takes paths away
                self._note(*_patch_key(patch), float(before), False, config.merged_paths)
                continue
            asked.append(patch)
            tests.append(test)
        for patch, test, pulled in zip(asked, tests, run_tests(tests, self.puller), strict=True):
            paths = float(self._paths(pulled, test))
            merged = paths >= config.merged_paths
            self._note(*_patch_key(patch), paths, merged, config.merged_paths)
            if merged:
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

    def _settled(self, kind: str, centre: Float64[np.ndarray, " 3"], size: int, gap: float) -> bool:
        """Whether the same place was asked before and has hardly changed since."""
        for known in self.standing:
            if known.kind != kind or np.linalg.norm(known.centre - centre) > self.config.same_place:
                continue
            grown = kind == "merge" and size > self.config.grown * known.size
            return not grown and gap > known.gap - self._step(known)
        return False

    def _step(self, known: Decision) -> float:
        """How much [spacings] a gap must close before it is worth asking again.

        More where the answer cannot turn yet: a patch without any path, still wider than a seam,
        and a neck with many paths, for they come and go over a fifth of the opening.
        """
        config = self.config
        if known.kind == "merge":
            far = known.paths == 0 and known.gap - config.closer_far > config.seam_gap
            return config.closer_far if far else config.closer
        beyond = 1 - config.split_paths / max(known.paths, config.split_paths)
        return max(config.closer, config.closer_far * known.gap * beyond)

    def _note(
        self,
        kind: str,
        centre: Float64[np.ndarray, " 3"],
        size: int,
        gap: float,
        paths: float,
        passed: bool,
        threshold: float,
    ) -> None:
        margin = abs(paths - threshold) / threshold
        made = Decision(
            kind=kind,
            centre=centre,
            size=size,
            gap=gap,
            paths=paths,
            passed=passed,
            margin=margin,
        )
        self.decisions.append(made)
        far = self.config.same_place
        self.standing = [
            d for d in self.standing if d.kind != kind or np.linalg.norm(d.centre - centre) > far
        ]
        if not passed:
            self.standing.append(made)

    def _state(self) -> FrameState:
        graph = self.graph
        pieces = graph.pieces()
        return FrameState(
            pieces=pieces,
            contacts=graph.pairs[graph.contact],
            decisions=tuple(self.decisions),
            bonds=graph.bonded_keys(SIDE_BOND),
            touching=graph.touching(self.config.static.radius),
        )


def _patch_key(patch: Patch) -> tuple[str, Float64[np.ndarray, " 3"], int, float]:
    return "merge", patch.centre, len(patch.pairs), patch.gap


def _neck_key(neck: Neck, spacing: float) -> tuple[str, Float64[np.ndarray, " 3"], int, float]:
    return "split", neck.centre, len(neck.core), neck.opening / spacing
