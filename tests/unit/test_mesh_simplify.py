"""Simplified meshes: the bound on the error, what must survive, and that faces do go."""

from collections.abc import Sequence

import manifold3d
import numpy as np
import open3d
import pytest
import trimesh

from doughdata.mesh.checks import is_edge_manifold, is_vertex_manifold, mesh_genus
from doughdata.mesh.dual_contouring import DualContouring, DualContouringConfig
from doughdata.mesh.marching_cubes import MarchingCubes, MarchingCubesConfig
from doughdata.mesh.simplify import distance_between, simplify
from doughdata.mesh.surface_nets import SurfaceNets, SurfaceNetsConfig
from doughschemas import BadInputError, ComponentMesh, FrameTopology, SceneGraph

SPACING = 0.002
RING = (0.020, 0.0075)  # [m], radii of ring and tube


def lattice(low: Sequence[float], high: Sequence[float], *, seed: int = 0) -> np.ndarray:
    """Jittered particles that fill a box [m]."""
    rng = np.random.default_rng(seed)
    axes = [np.arange(a + SPACING / 2, b, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return points + rng.uniform(-0.2, 0.2, points.shape) * SPACING


def frame() -> tuple[np.ndarray, FrameTopology]:
    """A ring, and two blocks in it and beside it that touch it."""
    points = lattice((-0.028, -0.028, -0.008), (0.028, 0.028, 0.008))
    across = np.hypot(points[:, 0], points[:, 1]) - RING[0]
    ring = points[np.hypot(across, points[:, 2]) < RING[1]]
    inner = lattice((-0.008, -0.008, -0.006), (0.008, 0.008, 0.006), seed=1)
    outer = lattice((0.0275, -0.012, -0.008), (0.040, 0.012, 0.008), seed=2)
    clouds = (ring, inner, outer)
    sizes = [len(cloud) for cloud in clouds]
    components = np.arange(3, dtype=np.uint8)
    graph = SceneGraph(
        positions=np.zeros((3, 3), np.float32),
        components=components,
        particles=np.array(sizes, np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    topology = FrameTopology(
        labels=np.repeat(components, sizes),
        genus=(1, 0, 0),
        graph=graph,
        contacts=np.zeros((0, 2), np.int32),
    )
    return np.concatenate(clouds).astype(np.float32), topology


@pytest.fixture(scope="module")
def meshes() -> tuple[ComponentMesh, ...]:
    """The frame by dual contouring."""
    return DualContouring().mesh(*frame(), spacing=SPACING).meshes


def distance(mesh: ComponentMesh, other: ComponentMesh) -> float:
    """Greatest distance [m] of 50,000 random points of a mesh from another."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, _ = trimesh.sample.sample_surface(surface, 50_000, seed=0)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(other.vertices, other.faces)
    return float(scene.compute_distance(points.astype(np.float32)).numpy().max())


def shared_volume(meshes: Sequence[ComponentMesh]) -> float:
    """Greatest volume [m3] that two of the meshes share."""
    solids = [
        manifold3d.Manifold(manifold3d.Mesh64(m.vertices.astype(np.float64), m.faces))
        for m in meshes
    ]
    assert [solid.status() for solid in solids] == [manifold3d.Error.NoError] * len(solids)
    return max((a ^ b).volume() for i, a in enumerate(solids) for b in solids[:i])


@pytest.mark.parametrize("bound", [0.0001, 0.0004, 0.001])
def test_surface_stays_within_the_bound(meshes: tuple, bound: float) -> None:
    """Random points of either surface are at most the bound from the other (Hausdorff)."""
    for before, after in zip(meshes, simplify(meshes, max_error=bound), strict=True):
        assert distance(before, after) <= 1.02 * bound
        assert distance(after, before) <= 1.02 * bound


@pytest.mark.parametrize("bound", [0.0001, 0.0004, 0.001, 0.004])
def test_what_a_mesh_promises_survives(meshes: tuple, bound: float) -> None:
    """Closed, manifold, of its genus, without overlap and outward, whatever the bound."""
    after = simplify(meshes, max_error=bound)
    for old, new in zip(meshes, after, strict=True):
        assert is_edge_manifold(new.faces)
        assert is_vertex_manifold(new.faces)
        assert mesh_genus(new.faces) == mesh_genus(old.faces)
        assert trimesh.Trimesh(new.vertices, new.faces, process=False).volume > 0
    assert shared_volume(after) <= 1e-15


def test_a_wider_bound_leaves_fewer_faces(meshes: tuple) -> None:
    """At 0.1 mm some faces go, at 0.4 mm more than half of them."""
    before, fine, coarse = (
        sum(len(m.faces) for m in group)
        for group in (
            meshes,
            simplify(meshes, max_error=0.0001),
            simplify(meshes, max_error=0.0004),
        )
    )
    assert fine < before
    assert coarse < 0.5 * before


def test_flat_sides_need_two_triangles() -> None:
    """A finely meshed cube is its twelve triangles again, at its own vertices."""
    cube = trimesh.creation.box()
    for _ in range(4):
        cube = cube.subdivide()
    fine = ComponentMesh(
        vertices=np.asarray(cube.vertices, np.float32), faces=np.asarray(cube.faces, np.uint32)
    )
    (plain,) = simplify([fine], max_error=0.001)
    assert len(plain.faces) == 12
    assert trimesh.Trimesh(plain.vertices, plain.faces).volume == pytest.approx(1.0)


def test_distance_between_nested_spheres_is_their_gap() -> None:
    """Of two concentric spheres the distance is the difference of their radii."""
    balls = [trimesh.creation.icosphere(5, radius) for radius in (1.0, 1.1)]
    large, small = (
        ComponentMesh(
            vertices=np.asarray(b.vertices, np.float32), faces=np.asarray(b.faces, np.uint32)
        )
        for b in reversed(balls)
    )
    assert distance_between(large, small) == pytest.approx(0.1, abs=1e-3)


def test_empty_meshes_stay_empty(meshes: tuple) -> None:
    """A component without particles keeps its place."""
    empty = ComponentMesh(vertices=np.zeros((0, 3), np.float32), faces=np.zeros((0, 3), np.uint32))
    after = simplify([empty, meshes[1]], max_error=0.0002)
    assert len(after[0].faces) == 0
    assert len(after[1].faces) > 0


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan")])
def test_a_bound_that_is_none_is_refused(meshes: tuple, bound: float) -> None:
    """The error says what was expected."""
    with pytest.raises(BadInputError, match="positive distance"):
        simplify(meshes, max_error=bound)


@pytest.mark.parametrize(
    ("mesher", "config"),
    [
        (DualContouring, DualContouringConfig),
        (SurfaceNets, SurfaceNetsConfig),
        (MarchingCubes, MarchingCubesConfig),
    ],
)
def test_meshers_simplify_when_told_to(mesher: type, config: type) -> None:
    """Fewer faces come out, the label grid is that of the full mesh, bit for bit."""
    full = mesher().mesh(*frame(), spacing=SPACING)
    fewer = mesher(config(simplify=0.0004)).mesh(*frame(), spacing=SPACING)
    assert sum(len(m.faces) for m in fewer.meshes) < 0.7 * sum(len(m.faces) for m in full.meshes)
    assert np.array_equal(fewer.label_grid.labels, full.label_grid.labels)
