"""What the check decides about cuts, contacts and threads, and how sure it says it is."""

from dataclasses import replace

import numpy as np
import pytest

from doughdata.scenes.materials import material_preset
from doughdata.scenes.tools import PRESETS
from doughdata.sim.pull import MpmPullApart
from doughdata.stages import PullProblem
from doughdata.topology.bridges import weak_bridges
from doughdata.topology.decisions import UNSURE
from doughdata.topology.dynamic import DynamicCheck
from doughdata.topology.fingers import gripper_at
from doughdata.topology.history import History
from doughdata.topology.merges import merge_patches
from tests.topology_states import (
    SPACING,
    bar,
    cut_bar,
    lattice,
    pinched_link,
    pressed_blocks,
    record,
    sliced_ring,
)

CHECK = DynamicCheck(pull_apart=MpmPullApart())


def test_a_saw_cut_does_not_heal() -> None:
    """Halves that come back to 2.2 spacings from each other stay two, though a new action began."""
    topology = CHECK.check(*cut_bar(0.0024))
    assert [frame.num_components for frame in topology.frames] == [1, 2, 2, 2, 2]
    assert [(e.frame, e.kind) for e in topology.events] == [(1, "split")]


def test_a_cut_that_is_pressed_together_merges_again() -> None:
    """Halves pushed back to where they were are one: a split and a merge are recorded."""
    topology = CHECK.check(*cut_bar(0.0))
    assert [frame.num_components for frame in topology.frames] == [1, 2, 2, 1, 1]
    assert [(e.frame, e.kind) for e in topology.events] == [(1, "split"), (3, "merge")]


def test_walls_that_only_touch_keep_their_hole() -> None:
    """A link whose walls bow in to 1.8 spacings of each other keeps its hole, without an event."""
    topology = CHECK.check(*pinched_link(0.0016))
    assert [frame.genus for frame in topology.frames] == [(1,)] * 6
    assert len(topology.frames[-1].contacts) > 100
    assert topology.events == ()


def test_walls_that_are_pressed_together_make_a_figure_eight() -> None:
    """A link whose walls lie at lattice distance in the middle has two holes: a self-merge."""
    topology = CHECK.check(*pinched_link(0.0))
    assert topology.frames[0].genus == (1,)
    assert topology.frames[-1].genus == (2,)
    assert [e.kind for e in topology.events] == ["self_merge"]


@pytest.mark.parametrize(("threads", "pieces"), [(1, 2), (16, 1)])
def test_a_thread_does_not_hold_two_blocks(threads: int, pieces: int) -> None:
    """Once a finger has cut somewhere, blocks that hang together by one thread are two."""
    low, high = (lattice((-0.006, a, 0), (0.006, a + 0.012, 0.012)) for a in (-0.018, 0.006))
    side = round(threads**0.5)
    thread = lattice((-SPACING * side / 2, -0.006, 0), (SPACING * side / 2, 0.006, SPACING * side))
    scene, particles = record(np.concatenate([low, thread, high]))
    history = History.start(scene, particles, CHECK.config, None)
    assert len(np.unique(history.graph.pieces())) == 1
    weak = weak_bridges(history.graph, smallest=50.0, weakest=CHECK.config.split_paths)
    for bridge in weak:
        assert 1 <= bridge.paths < CHECK.config.split_paths
        history.graph.cut(bridge.side)
    assert len(np.unique(history.graph.pieces())) == pieces


def test_a_bond_along_the_table_does_not_pass_a_finger() -> None:
    """A finger stands on the table: what lies a millimetre above it has the finger in between."""
    scene, particles = record(bar())
    particles.tool_poses.position[0, 0] = [-0.010, 0.0, 0.0]
    scene = replace(scene, tools=(PRESETS["narrow"],))
    gripper = gripper_at(scene, particles.tool_poses, 0)
    depth = CHECK.config.finger_depth * SPACING
    for height in (0.0002, 0.001, 0.020):
        ends = np.array([[0.0, -0.0017, height], [0.0, 0.0017, height]])
        distances = gripper.distances_within(ends, 0.01, raised=2 * depth)
        through = gripper.between(ends[:1], ends[1:], depth, distances=distances[:, [[0, 1]]])
        assert through.all()


def test_pulls_are_of_the_scenes_own_material() -> None:
    """Every pull test is handed the material of the scene that is checked."""
    seen = []

    class Spy(MpmPullApart):
        def pull_apart(self, problems: list[PullProblem]) -> list[np.ndarray]:
            seen.extend(problem.material for problem in problems)
            return super().pull_apart(problems)

    scene, particles = pressed_blocks()
    clay = material_preset("clay")
    DynamicCheck(pull_apart=Spy()).check(replace(scene, material=clay), particles)
    assert seen
    assert set(seen) == {clay}


@pytest.mark.parametrize("state", [cut_bar(0.0), pressed_blocks(), sliced_ring()])
def test_an_event_near_its_threshold_is_ambiguous(state: tuple) -> None:
    """A key frame is marked if one of its events has a small margin, whatever made that event."""
    topology = CHECK.check(*state)
    assert topology.events
    for event in topology.events:
        assert event.margin >= UNSURE or topology.frames[event.frame].ambiguous


def test_a_patch_has_the_same_sides_for_any_numbering() -> None:
    """Renumbering the particles of two touching blocks leaves the sizes of what is pulled."""
    _, particles = pressed_blocks(0.0004)
    scene, _ = pressed_blocks()
    last = replace(particles, positions=particles.positions[-1:])
    sizes = []
    for order in (np.arange(len(last.object_ids)), np.random.default_rng(4).permutation(432)):
        moved = replace(last, positions=last.positions[:, order], object_ids=last.object_ids[order])
        history = History.start(scene, moved, CHECK.config, None)
        patches = merge_patches(
            history.graph,
            gap=2.6,
            nearest=1.7,
            link=2.2,
            length=0.012,
            radius=0.016,
            seam_gap=1.7,
            settled=lambda _: False,
        )
        sizes.append([sorted((len(patch.first), len(patch.second))) for patch in patches])
    assert sizes[0] == sizes[1]
    assert sizes[0][0] == [216, 216]
