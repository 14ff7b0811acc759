"""Laws that hold for any particles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from doughdata.mesh.checks import is_edge_manifold, is_vertex_manifold, mesh_volume
from doughdata.mesh.dual_contouring import DualContouring
from doughdata.mesh.marching_cubes import MarchingCubes
from doughdata.mesh.surface_nets import SurfaceNets
from doughschemas import STRAY, FrameTopology, SceneGraph

SPACING = 0.002
MESHERS = [DualContouring, MarchingCubes, SurfaceNets]


def topology_of(labels: np.ndarray, components: int, contacts: np.ndarray) -> FrameTopology:
    """Topology with given labels and contacts and nothing else."""
    graph = SceneGraph(
        positions=np.zeros((components, 3), np.float32),
        components=np.arange(components, dtype=np.uint8),
        particles=np.ones(components, np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    return FrameTopology(
        labels=labels.astype(np.uint8), genus=(0,) * components, graph=graph, contacts=contacts
    )


@st.composite
def frames(draw: st.DrawFn) -> tuple[np.ndarray, FrameTopology]:
    """Random, even interleaved, components with strays and random contacts."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    components = draw(st.integers(1, 3))
    count = draw(st.integers(components, 300))
    size = draw(st.sampled_from([0.002, 0.01, 0.03])) * rng.uniform(0.1, 1.0, 3)
    positions = rng.uniform(-size, size, (count, 3)).astype(np.float32)
    labels = np.arange(count) % components
    if draw(st.booleans()):  # side by side instead of interleaved
        labels = labels[np.argsort(np.argsort(positions[:, 0]))] * 0 + np.minimum(
            np.argsort(np.argsort(positions[:, 0])) * components // count, components - 1
        )
    labels[rng.random(count) < 0.05] = STRAY
    contacts = rng.integers(0, count, (draw(st.sampled_from([0, 60])), 2)).astype(np.int32)
    return positions, topology_of(labels, components, contacts)


@pytest.mark.parametrize("mesher", MESHERS)
@settings(max_examples=40, deadline=None)
@given(frame=frames())
def test_any_particles_give_closed_manifolds(mesher: type, frame: tuple) -> None:
    """Every component with particles gets a non-empty, outward, edge- and vertex-manifold mesh."""
    positions, topology = frame
    result = mesher().mesh(positions, topology, spacing=SPACING)
    assert len(result.meshes) == topology.num_components
    for label, mesh in enumerate(result.meshes):
        assert (len(mesh.faces) > 0) == bool((topology.labels == label).any())
        if len(mesh.faces):
            assert is_edge_manifold(mesh.faces)
            assert is_vertex_manifold(mesh.faces)
            assert mesh.faces.max() < len(mesh.vertices)
            assert mesh_volume(mesh.vertices, mesh.faces) > 0


@settings(max_examples=15, deadline=None)
@given(frame=frames(), steps=st.tuples(*[st.integers(-6, 6)] * 3))
def test_shift_by_whole_cells_shifts_the_mesh(frame: tuple, steps: tuple[int, int, int]) -> None:
    """Moving particles by whole millimetres and cells (5 mm) moves meshes and grid along."""
    positions, topology = frame
    shift = 0.005 * np.array(steps)
    moved = (positions.astype(np.float64) + shift).astype(np.float32)
    start = (moved.astype(np.float64) - shift).astype(np.float32)
    here = DualContouring().mesh(start, topology, spacing=SPACING)
    there = DualContouring().mesh(moved, topology, spacing=SPACING)
    for a, b in zip(here.meshes, there.meshes, strict=True):
        assert len(a.faces) == pytest.approx(len(b.faces), rel=0.02, abs=8)
        assert mesh_volume(a.vertices, a.faces) == pytest.approx(
            mesh_volume(b.vertices - shift, b.faces), rel=1e-3, abs=1e-12
        )


@settings(max_examples=15, deadline=None)
@given(frame=frames(), seed=st.integers(0, 99))
def test_particle_order_does_not_matter(frame: tuple, seed: int) -> None:
    """A permutation of the particles gives the same meshes and grid."""
    positions, topology = frame
    order = np.random.default_rng(seed).permutation(len(positions))
    rank = np.argsort(order)
    permuted = topology_of(
        topology.labels[order],
        topology.num_components,
        rank[topology.contacts].astype(np.int32),
    )
    here = DualContouring().mesh(positions, topology, spacing=SPACING)
    there = DualContouring().mesh(positions[order], permuted, spacing=SPACING)
    assert np.array_equal(here.label_grid.labels, there.label_grid.labels)
    for a, b in zip(here.meshes, there.meshes, strict=True):
        assert np.array_equal(a.faces, b.faces)
        assert np.allclose(a.vertices, b.vertices, atol=1e-9)
