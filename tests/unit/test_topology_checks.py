"""States whose topology anyone would agree on, built from lattices."""

import numpy as np
import pytest

from doughdata.sim.pull import MpmPullApart
from doughdata.topology.dynamic import DynamicCheck
from doughdata.topology.skeletons import cycle_rank
from doughdata.topology.static import StaticCheck
from doughschemas import STRAY, BadInputError, SceneGraph, Topology
from tests.topology_states import (
    bar,
    block,
    lattice,
    pressed_blocks,
    record,
    ring,
    sliced_ring,
    torn_bar,
)


def check_contract(topology: Topology) -> None:
    """What every record must hold: contiguous labels, simple graphs, cycle rank = genus."""
    for frame in topology.frames:
        used = set(frame.labels.tolist()) - {STRAY}
        assert used == set(range(frame.num_components))
        assert ranks(frame.graph, frame.num_components) == list(frame.genus)
        ends = [tuple(sorted(edge)) for edge in frame.graph.edges.tolist()]
        assert len(set(ends)) == len(ends)
        assert all(a != b for a, b in ends)
        for k in range(frame.num_components):
            held = frame.graph.particles[frame.graph.components == k].sum()
            assert held == (frame.labels == k).sum()


def ranks(graph: SceneGraph, number: int) -> list[int]:
    found = []
    for k in range(number):
        nodes = np.flatnonzero(graph.components == k)
        own = np.isin(graph.edges, nodes).all(axis=1)
        edges = np.searchsorted(nodes, graph.edges[own]).reshape(-1, 2)
        found.append(cycle_rank(len(nodes), edges.astype(np.int32)))
        assert len(edges) - len(nodes) + 1 == found[-1], "a component's graph is one part"
    return found


SOLIDS = {
    "bar": (bar(), [0]),
    "ring": (ring(), [1]),
    "bar with a gap": (np.concatenate([bar(-0.020), bar(0.020)]), [0, 0]),
    "ring and block": (np.concatenate([ring(), block(0.045)]), [0, 1]),
}


@pytest.mark.parametrize("check", [DynamicCheck(), StaticCheck()], ids=["dynamic", "static"])
@pytest.mark.parametrize("name", SOLIDS)
def test_plain_solids(name: str, check: DynamicCheck | StaticCheck) -> None:
    """Solids that nothing has touched have the components and genus that they were built with."""
    x, genus = SOLIDS[name]
    topology = check.check(*record(x, x))
    check_contract(topology)
    for frame in topology.frames:
        assert sorted(frame.genus) == genus
    assert topology.events == ()
    assert topology.static_num_components.tolist() == [len(genus)] * 2
    assert [sorted(own) for own in topology.static_genus] == [genus] * 2


def test_touching_bodies_stay_two() -> None:
    """Bodies placed a spacing apart are two for the dynamic check and one for the static one."""
    x = np.concatenate([block(-0.0065), block(0.0065, seed=1)])
    ids = np.repeat([0, 1], len(x) // 2).astype(np.uint8)
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(*record(x, ids=ids))
    assert topology.frames[0].num_components == 2
    assert len(topology.frames[0].contacts) > 20
    sides = ids[topology.frames[0].contacts]
    assert (sides[:, 0] != sides[:, 1]).all()
    assert topology.static_num_components.tolist() == [1]


@pytest.mark.parametrize(("gap", "merged"), [(0.0, True), (0.0024, False)])
def test_pull_decides_about_pressed_bodies(gap: float, merged: bool) -> None:
    """Bodies pressed to lattice distance hold when pulled; 1.2 spacings apart they part."""
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(*pressed_blocks(gap))
    assert [f.num_components for f in topology.frames] == [2, 1 if merged else 2]
    check_contract(topology)
    if merged:
        (event,) = topology.events
        assert (event.frame, event.kind) == (1, "merge")
        assert (event.components_before, event.components_after) == ((0, 1), (0,))
        assert event.margin > 0


def test_missing_pull_apart_is_named() -> None:
    """A check that needs a pull and has none says what to hand in."""
    x = np.concatenate([block(-0.006), block(0.006, seed=1)])
    ids = np.repeat([0, 1], len(x) // 2).astype(np.uint8)
    with pytest.raises(BadInputError, match="pull_apart="):
        DynamicCheck().check(*record(x, ids=ids))


def test_torn_bar_is_a_split() -> None:
    """A bar whose halves move far apart is split, and the larger half keeps its label."""
    scene, particles = torn_bar()
    x = particles.positions[0]
    topology = DynamicCheck().check(scene, particles)
    assert [f.num_components for f in topology.frames] == [1, 1, 2, 2]
    assert [(e.frame, e.kind) for e in topology.events] == [(2, "split")]
    last = topology.frames[-1].labels
    assert (last[x[:, 1] < 0.0] == 0).all()
    assert (last[x[:, 1] > 0.008] == 1).all()
    check_contract(topology)


def test_bonds_rebuild_the_components() -> None:
    """Replaying the bonds made and broken gives a graph with the components of every frame."""
    from doughdata.topology.pairs import connected

    x = bar()
    far = x + np.where(x[:, 1:2] > 0.004, 0.012, 0.0) * [0.0, 1.0, 0.0]
    topology = DynamicCheck().check(*record(x, far))
    bonds: set[tuple[int, int]] = set()
    for frame, made, broken in zip(
        topology.frames, topology.bonds_made, topology.bonds_broken, strict=True
    ):
        bonds |= {tuple(pair) for pair in made.tolist()}
        bonds -= {tuple(pair) for pair in broken.tolist()}
        piece = connected(np.array(sorted(bonds)), len(x))
        assert len(np.unique(piece)) == frame.num_components


def test_crumbs_are_stray() -> None:
    """A scrap below the stated size is no component; its particles are marked stray."""
    x = np.concatenate([bar(), lattice((0.03, 0, 0), (0.034, 0.004, 0.004))])
    topology = DynamicCheck().check(*record(x))
    assert topology.frames[0].num_components == 1
    assert (topology.frames[0].labels == STRAY).sum() == 8


def test_blade_through_a_ring_is_a_self_split() -> None:
    """A blade that goes right through one tube of a ring takes its handle: a self-split."""
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(*sliced_ring())
    assert [f.genus for f in topology.frames] == [(1,)] * 5 + [(0,)] * 5
    assert [(e.frame, e.kind) for e in topology.events] == [(5, "self_split")]
    check_contract(topology)
