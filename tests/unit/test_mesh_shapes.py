"""Meshes of sampled solids against closed forms, trimesh and the signed distance of the solid."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import manifold3d
import numpy as np
import pytest
import skimage.measure
import trimesh

from doughdata.mesh.component import SolidConfig
from doughdata.mesh.contour import contour
from doughdata.mesh.dual_contouring import DualContouring
from doughdata.mesh.marching_cubes import MarchingCubes
from doughdata.mesh.sharpen import sharpen
from doughdata.mesh.solid import Solid as LabelledSolid
from doughdata.mesh.surface_nets import SurfaceNets
from doughdata.stages import Mesher
from doughschemas import ComponentMesh, ComponentMeshes, FrameTopology, SceneGraph

SPACING = 0.002


@dataclass(frozen=True)
class Solid:
    """Signed distance [m], volume [m3] and genus in closed form."""

    distance: Callable[[np.ndarray], np.ndarray]
    volume: float
    genus: int


def torus(p: np.ndarray) -> np.ndarray:
    """Ring radius 20 mm, tube radius 6 mm."""
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.020, p[:, 2]) - 0.006


def cylinder(p: np.ndarray) -> np.ndarray:
    """Radius 15 mm, height 20 mm."""
    across, up = np.hypot(p[:, 0], p[:, 1]) - 0.015, np.abs(p[:, 2]) - 0.010
    outside = np.hypot(np.maximum(across, 0), np.maximum(up, 0))
    return np.minimum(np.maximum(across, up), 0) + outside


def box(p: np.ndarray, half: tuple[float, float, float] = (0.018, 0.009, 0.010)) -> np.ndarray:
    """Half sides 18, 9, 10 mm."""
    q = np.abs(p) - np.array(half)
    return np.minimum(q.max(axis=1), 0) + np.linalg.norm(np.maximum(q, 0), axis=1)


def plate(p: np.ndarray) -> np.ndarray:
    """48 x 28 x 10 mm with two holes of radius 6 mm; exact near the surface."""
    solid = box(p, (0.024, 0.014, 0.005))
    for x in (-0.011, 0.011):
        solid = np.maximum(solid, 0.006 - np.hypot(p[:, 0] - x, p[:, 1]))
    return solid


SOLIDS = {
    "torus": Solid(torus, 2 * np.pi**2 * 0.020 * 0.006**2, 1),
    "cylinder": Solid(cylinder, np.pi * 0.015**2 * 0.020, 0),
    "box": Solid(box, 0.036 * 0.018 * 0.020, 0),
    "plate": Solid(plate, 0.048 * 0.028 * 0.010 - 2 * np.pi * 0.006**2 * 0.010, 2),
}


def sample(
    solid: Solid, *, spacing: float, seed: int = 0, rows: np.ndarray | None = None
) -> np.ndarray:
    """Jittered lattice inside a solid [m], (particles, 3) float32; its rows may be turned."""
    rng = np.random.default_rng(seed)
    far = 0.026 if rows is None else 0.048
    axis = np.arange(-far, far, spacing) + 0.5 * spacing
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    points = points if rows is None else points @ rows.T
    points += rng.uniform(-0.2, 0.2, points.shape) * spacing
    return points[solid.distance(points) < 0].astype(np.float32)


def one_frame(*clouds: np.ndarray, contacts: np.ndarray | None = None) -> tuple:
    """Positions and topology of clouds that are one component each."""
    labels = np.repeat(np.arange(len(clouds), dtype=np.uint8), [len(c) for c in clouds])
    graph = SceneGraph(
        positions=np.zeros((len(clouds), 3), np.float32),
        components=np.arange(len(clouds), dtype=np.uint8),
        particles=np.array([len(c) for c in clouds], np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    topology = FrameTopology(
        labels=labels,
        genus=(0,) * len(clouds),
        graph=graph,
        contacts=np.zeros((0, 2), np.int32) if contacts is None else contacts,
    )
    return np.concatenate(clouds), topology


def mesh_of(mesher: Mesher, *clouds: np.ndarray) -> ComponentMeshes:
    """Meshes of clouds that are one component each."""
    positions, topology = one_frame(*clouds)
    return mesher.mesh(positions, topology, spacing=SPACING)


def judge(mesh: ComponentMesh) -> trimesh.Trimesh:
    """The mesh as trimesh reads it, unprocessed."""
    return trimesh.Trimesh(mesh.vertices.astype(np.float64), mesh.faces, process=False)


def sample_surface(mesh: ComponentMesh) -> np.ndarray:
    """Points spread evenly over a mesh."""
    return np.asarray(trimesh.sample.sample_surface(judge(mesh), 20000, seed=0)[0])


def distance_to(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Unsigned distance of points to a mesh, by Open3D."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    return scene.compute_distance(points.astype(np.float32)).numpy()


def points_on(solid: Solid) -> np.ndarray:
    """Points within 10 um of a solid's surface: a fine contour of it, the rest left out."""
    step = 0.001
    axis = np.arange(-0.027, 0.027, step)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    field = solid.distance(nodes.reshape(-1, 3)).reshape(nodes.shape[:3])
    points = skimage.measure.marching_cubes(field, 0.0)[0] * step + axis[0]
    points = points[np.abs(solid.distance(points)) < 1e-5]
    assert len(points) > 1000
    return points


MESHERS = [DualContouring, MarchingCubes, SurfaceNets]
CASES = [(DualContouring, name, spacing) for name in SOLIDS for spacing in (0.002, 0.001)]
CASES += [(mesher, name, 0.002) for mesher in MESHERS[1:] for name in SOLIDS]
CASE_IDS = [f"{mesher.__name__}-{name}-{spacing * 1e3:g}mm" for mesher, name, spacing in CASES]


@pytest.fixture(scope="module", params=CASES, ids=CASE_IDS)
def case(request: pytest.FixtureRequest) -> tuple:
    """A solid, the spacing of its particles and its mesh.

    The mesher is told the spacing at which the particles stand for exactly the solid's volume; it
    is within 1 % of the lattice's.
    """
    mesher, name, spacing = request.param
    solid = SOLIDS[name]
    cloud = sample(solid, spacing=spacing)
    told = (solid.volume / len(cloud)) ** (1 / 3)
    meshes = mesher().mesh(*one_frame(cloud), spacing=told)
    return solid, spacing, meshes.meshes[0]


def test_mesh_of_solid_is_closed(case: tuple) -> None:
    """A sampled solid gives one watertight, consistently outward shell of the solid's genus."""
    solid, _, mesh = case
    found = judge(mesh)
    assert found.is_watertight
    assert found.is_winding_consistent
    assert found.body_count == 1
    assert found.euler_number == 2 - 2 * solid.genus


def test_mesh_volume_is_that_of_the_solid(case: tuple) -> None:
    """The mesh holds the solid's volume within 0.3 %; 1 % is what is promised."""
    solid, _, mesh = case
    assert judge(mesh).volume == pytest.approx(solid.volume, rel=0.003)


def test_mesh_follows_solid(case: tuple) -> None:
    """The surface lies within 0.25 spacing (RMS) of the solid's, measured by its closed form."""
    solid, spacing, mesh = case
    error = solid.distance(sample_surface(mesh))
    assert np.sqrt(np.mean(error**2)) <= 0.25 * spacing


def test_no_point_of_mesh_or_solid_is_far_from_the_other(case: tuple) -> None:
    """Both ways, edges included, the greatest distance is at most 1.5 cells of the grid."""
    solid, spacing, mesh = case
    cell = spacing / SolidConfig().cells_per_spacing
    points = np.concatenate([sample_surface(mesh), mesh.vertices])
    assert np.abs(solid.distance(points)).max() <= 1.5 * cell
    assert distance_to(mesh.vertices, mesh.faces, points_on(solid)).max() <= 1.5 * cell


@pytest.mark.parametrize("mesher", MESHERS)
def test_touching_bodies_do_not_overlap(mesher: type) -> None:
    """Two blocks pressed together as two components share no volume and keep their own."""
    left = sample(SOLIDS["box"], spacing=SPACING)
    right = sample(SOLIDS["box"], spacing=SPACING, seed=1) + np.array(
        [0.0, 0.0179, 0.0], np.float32
    )
    meshes = mesh_of(mesher(), left, right).meshes
    solids = [
        manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices.astype(np.float64), mesh.faces))
        for mesh in meshes
    ]
    assert [solid.status() for solid in solids] == [manifold3d.Error.NoError] * 2
    assert (solids[0] ^ solids[1]).volume() <= 1e-12
    for mesh, cloud in zip(meshes, (left, right), strict=True):
        assert judge(mesh).volume == pytest.approx(len(cloud) * SPACING**3, rel=0.01)


def box_edges(half: np.ndarray) -> np.ndarray:
    """Points along the twelve edges of a box, without their ends."""
    corners = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    ends = [(a, b) for a in range(8) for b in range(a) if (corners[a] != corners[b]).sum() == 1]
    return np.concatenate([np.linspace(corners[a], corners[b], 40)[2:-2] for a, b in ends])


def rims() -> np.ndarray:
    """Points along the two circles of the cylinder."""
    turns = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    circle = 0.015 * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1)
    return np.concatenate([circle + np.array([0.0, 0.0, z]) for z in (-0.010, 0.010)])


EDGES = {"box": box_edges(np.array([0.018, 0.009, 0.010])), "cylinder": rims()}
TURN = trimesh.transformations.euler_matrix(0.4, 0.3, 0.2)[:3, :3]


def test_edges_of_sampled_solids_are_sharper_than_by_marching_cubes() -> None:
    """Box and cylinder, along the grid and turned, with particles in any rows: 0.7x the error."""
    errors = np.zeros(2)
    spin = trimesh.transformations.euler_matrix(0.64, 0.27, 0.04)[:3, :3]
    for name, turn, rows in product(EDGES, (np.eye(3), TURN), (np.eye(3), spin)):
        solid = SOLIDS[name]
        cloud = sample(solid, spacing=SPACING, rows=rows) @ turn.T.astype(np.float32)
        told = (solid.volume / len(cloud)) ** (1 / 3)
        for k, mesher in enumerate((DualContouring(), MarchingCubes())):
            mesh = mesher.mesh(*one_frame(cloud), spacing=told).meshes[0]
            errors[k] += distance_to(mesh.vertices, mesh.faces, EDGES[name] @ turn.T).mean()
    assert errors[0] <= 0.7 * errors[1]


def test_dual_contouring_keeps_edges_sharper_than_marching_cubes() -> None:
    """Near the edges of a turned box, given its exact distance, it errs at most 0.55x as much."""
    axis = np.arange(-24, 25)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    shape = nodes.shape[:3]
    half = (14.0, 9.0, 7.0)
    field = box((nodes.reshape(-1, 3) @ TURN), half).reshape(shape).astype(np.float32)
    solid = LabelledSolid(
        field=field,
        labels=np.where(field < 0, 0, 255).astype(np.uint8),
        origin=np.zeros(3, np.int64),
        cell=1.0,
        volumes=np.array([8.0 * 14 * 9 * 7]),
    )
    sharp = contour(solid, regularisation=0.05)
    round_vertices, round_faces, _, _ = skimage.measure.marching_cubes(field, 0.0)
    edge = box_edges(np.array(half)) @ TURN.T + 24.0
    errors = [
        distance_to(vertices, faces, edge).mean()
        for vertices, faces in (
            (sharp.vertices, sharp.faces),
            (round_vertices, round_faces),
        )
    ]
    assert errors[0] <= 0.55 * errors[1]


def test_sharpening_leaves_round_dough_alone_and_moves_edges_outward_only() -> None:
    """A ball of 12 mm has no edge; on a box no distance grows or falls by over half a spacing."""
    per = 1.6
    axis = np.arange(-20, 21)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).astype(float)
    ball = np.linalg.norm(nodes, axis=-1).astype(np.float32) - np.float32(12.0 * per / 2.0)
    assert sharpen(ball, per=per) is None
    turned = nodes.reshape(-1, 3) @ TURN
    fillet = box(turned, (11.2, 8.2, 7.2)).reshape(ball.shape) - 0.8
    sharp = sharpen(fillet.astype(np.float32), per=per)
    assert sharp is not None
    change = sharp - fillet
    assert change.max() <= 1e-6
    assert change.min() >= -0.5 * per - 1e-6
    exact = box(turned, (12.0, 9.0, 8.0)).reshape(ball.shape)
    corner = (np.abs(exact) < 1.0) & (fillet - exact > 0.15)
    assert np.abs(sharp - exact)[corner].mean() < 0.6 * (fillet - exact)[corner].mean()
