"""Whole frames: contacts kept open, strays, tiny and empty components, the label grid."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial import cKDTree

from doughdata import registry
from doughdata.mesh.checks import (
    is_edge_manifold,
    is_vertex_manifold,
    mesh_genus,
    mesh_volume,
    shell_count,
)
from doughdata.mesh.component import SolidConfig
from doughdata.mesh.dual_contouring import DualContouring
from doughdata.mesh.marching_cubes import MarchingCubes
from doughdata.mesh.surface_nets import SurfaceNets
from doughdata.stages import Mesher
from doughschemas import (
    NO_COMPONENT,
    STRAY,
    BadInputError,
    ComponentMeshes,
    FrameTopology,
    SceneGraph,
)

SPACING = 0.002
MESHERS = [DualContouring, MarchingCubes, SurfaceNets]


def lattice(low: Sequence[float], high: Sequence[float], *, seed: int = 0) -> np.ndarray:
    """Jittered particles that fill a box [m], (particles, 3) float32."""
    rng = np.random.default_rng(seed)
    axes = [np.arange(a + SPACING / 2, b, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return (points + rng.uniform(-0.2, 0.2, points.shape) * SPACING).astype(np.float32)


def run(
    mesher: Mesher,
    positions: np.ndarray,
    labels: np.ndarray,
    *,
    components: int,
    genus: int = 0,
    contacts: np.ndarray | None = None,
) -> ComponentMeshes:
    """Mesh positions with given labels, genus (of each) and contacts."""
    graph = SceneGraph(
        positions=np.zeros((components, 3), np.float32),
        components=np.arange(components, dtype=np.uint8),
        particles=np.ones(components, np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    topology = FrameTopology(
        labels=labels.astype(np.uint8),
        genus=(genus,) * components,
        graph=graph,
        contacts=np.zeros((0, 2), np.int32) if contacts is None else contacts.astype(np.int32),
    )
    return mesher.mesh(positions, topology, spacing=SPACING)


def closed_ring(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Square ring cut through at x = 0, y > 0, its ends `gap` [m] apart; and which side of it."""
    cloud = lattice((-0.020, -0.020, 0.0), (0.020, 0.020, 0.008))
    cloud = cloud[np.abs(cloud[:, :2]).max(axis=1) > 0.010]
    upper = cloud[:, 1] > 0
    side = np.where(upper & (np.abs(cloud[:, 0]) < 0.006), np.sign(cloud[:, 0]), 0)
    cloud[:, 0] += np.where(upper, np.sign(cloud[:, 0]) * gap / 2, 0).astype(np.float32)
    return cloud, side


@pytest.mark.parametrize("mesher", MESHERS)
@pytest.mark.parametrize("gap", [0.0, 0.0005, 0.002])
def test_unmerged_ends_stay_open(mesher: type, gap: float) -> None:
    """A ring whose ends touch is a ring when merged, and has genus 0 when named as contacts."""
    cloud, side = closed_ring(gap)
    labels = np.zeros(len(cloud))
    pairs = cKDTree(cloud).query_pairs(3 * SPACING, output_type="ndarray")
    contacts = pairs[side[pairs[:, 0]] * side[pairs[:, 1]] < 0]
    merged = run(mesher(), cloud, labels, components=1, genus=1).meshes[0]
    parted = run(mesher(), cloud, labels, components=1, contacts=contacts).meshes[0]
    assert mesh_genus(merged.faces) == 1
    assert mesh_genus(parted.faces) == 0
    assert shell_count(parted.faces) == 1
    assert is_edge_manifold(parted.faces)
    assert is_vertex_manifold(parted.faces)
    volume = mesh_volume(parted.vertices, parted.faces)
    assert volume == pytest.approx(len(cloud) * SPACING**3, rel=0.01)


def test_only_seams_that_change_the_genus_are_opened() -> None:
    """Where the closing has the label's genus already, contacts leave the mesh as it is."""
    cloud, side = closed_ring(0.0)
    labels = np.zeros(len(cloud))
    pairs = cKDTree(cloud).query_pairs(2 * SPACING, output_type="ndarray")
    contacts = pairs[side[pairs[:, 0]] * side[pairs[:, 1]] < 0]
    assert len(contacts) > 0
    plain = run(DualContouring(), cloud, labels, components=1, genus=1).meshes[0]
    named = run(DualContouring(), cloud, labels, components=1, genus=1, contacts=contacts).meshes[0]
    assert np.array_equal(plain.vertices, named.vertices)


def test_one_of_two_seams_is_opened() -> None:
    """Of a ring cut at two places, naming both, only as many seams open as the genus asks for."""
    cloud, side = closed_ring(0.0)
    lower = (cloud[:, 1] < 0) & (np.abs(cloud[:, 0]) < 0.006)
    pairs = cKDTree(cloud).query_pairs(3 * SPACING, output_type="ndarray")
    other = np.where(lower, np.sign(cloud[:, 0]), 0)
    contacts = pairs[
        (side[pairs[:, 0]] * side[pairs[:, 1]] < 0) | (other[pairs[:, 0]] * other[pairs[:, 1]] < 0)
    ]
    mesh = run(DualContouring(), cloud, np.zeros(len(cloud)), components=1, contacts=contacts)
    assert mesh_genus(mesh.meshes[0].faces) == 0
    assert shell_count(mesh.meshes[0].faces) == 1


@pytest.mark.parametrize("mesher", MESHERS)
def test_strays_leave_no_trace(mesher: type) -> None:
    """Particles labelled STRAY change neither mesh nor grid."""
    block = lattice((0, 0, 0), (0.02, 0.02, 0.01))
    crumbs = lattice((0.03, 0, 0), (0.036, 0.006, 0.004))
    labels = np.r_[np.zeros(len(block)), np.full(len(crumbs), STRAY)]
    alone = run(mesher(), block, labels[: len(block)], components=1)
    both = run(mesher(), np.concatenate([block, crumbs]), labels, components=1)
    assert np.array_equal(alone.meshes[0].vertices, both.meshes[0].vertices)
    assert np.array_equal(alone.meshes[0].faces, both.meshes[0].faces)
    assert np.array_equal(alone.label_grid.labels, both.label_grid.labels)


@pytest.mark.parametrize("mesher", MESHERS)
def test_every_component_with_particles_has_a_mesh(mesher: type) -> None:
    """Components of one particle, of particles on one spot and inside another are closed meshes."""
    block = lattice((0, 0, 0), (0.016, 0.016, 0.016))
    single = np.array([[0.03, 0.0, 0.0]], np.float32)
    spot = np.repeat(np.array([[0.0, 0.03, 0.0]], np.float32), 4, axis=0)
    buried = np.array([[0.008, 0.008, 0.008]], np.float32)
    clouds = (block, single, spot, buried)
    labels = np.repeat(np.arange(4), [len(c) for c in clouds])
    for mesh in run(mesher(), np.concatenate(clouds), labels, components=4).meshes:
        assert len(mesh.faces) > 0
        assert is_edge_manifold(mesh.faces)
        assert is_vertex_manifold(mesh.faces)
        assert mesh_volume(mesh.vertices, mesh.faces) > 0


@pytest.mark.parametrize("mesher", MESHERS)
def test_component_without_particles_is_empty(mesher: type) -> None:
    """A label that no particle has gives an empty mesh, and no particles at all an empty grid."""
    block = lattice((0, 0, 0), (0.01, 0.01, 0.01))
    assert len(run(mesher(), block, np.zeros(len(block)), components=2).meshes[1].faces) == 0
    nothing = run(mesher(), block, np.full(len(block), STRAY), components=1)
    assert len(nothing.meshes[0].faces) == 0
    assert (nothing.label_grid.labels == NO_COMPONENT).all()


def test_positions_that_are_not_finite_are_refused() -> None:
    """A NaN position raises an error that names the component."""
    block = lattice((0, 0, 0), (0.01, 0.01, 0.01))
    block[3, 1] = np.nan
    with pytest.raises(BadInputError, match="component 0"):
        run(DualContouring(), block, np.zeros(len(block)), components=1)


def test_loose_halves_come_out_as_one_shell() -> None:
    """Two halves of one component joined by a string of single particles are one closed shell."""
    left = lattice((0, 0, 0), (0.012, 0.012, 0.012))
    right = lattice((0.026, 0, 0), (0.038, 0.012, 0.012))
    string = np.array([[0.0155, 0.006, 0.006], [0.019, 0.006, 0.006], [0.0225, 0.006, 0.006]])
    cloud = np.concatenate([left, right, string.astype(np.float32)])
    mesh = run(DualContouring(), cloud, np.zeros(len(cloud)), components=1).meshes[0]
    assert shell_count(mesh.faces) == 1
    assert mesh_genus(mesh.faces) == 0


@pytest.mark.parametrize(
    ("mesher", "slack"), [(DualContouring, 0.48), (MarchingCubes, 0.48), (SurfaceNets, 0.98)]
)
def test_label_grid_is_what_the_meshes_hold(mesher: type, slack: float) -> None:
    """Further than `slack` cells from the surface a node has label k just when mesh k contains it.

    The mean of three crossings, where surface nets put a corner, is up to 0.58 cells inside of it,
    and the surface is moved by up to 0.4 cells to make up for that. Within two cells of another
    component corners are held in their cells, by up to a cell. Open3D judges.
    """
    import open3d

    clouds = lattice((0, 0, 0), (0.02, 0.016, 0.01)), lattice((0.021, 0, 0), (0.033, 0.02, 0.008))
    labels = np.repeat([0, 1], [len(c) for c in clouds])
    frame = run(mesher(), np.concatenate(clouds), labels, components=2)
    grid = frame.label_grid
    nodes = np.argwhere(np.ones(grid.labels.shape, bool)) * grid.spacing + grid.origin
    owner = grid.labels.reshape(-1)
    cell = SPACING / SolidConfig().cells_per_spacing
    distances = []
    for mesh in frame.meshes:
        scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(mesh.vertices, mesh.faces)
        distances.append(scene.compute_signed_distance(nodes.astype(np.float32)).numpy() / cell)
    for label, signed in enumerate(distances):
        beside = distances[1 - label] < 2.0
        clear = np.abs(signed) > np.where(beside, max(slack, 1.0), slack)
        assert np.array_equal(owner[clear] == label, signed[clear] < 0)


def test_label_grids_share_one_lattice() -> None:
    """Grid nodes lie on multiples of the grid spacing, wherever the dough lies."""
    for shift in (0.0, 0.00037, 0.0123):
        block = lattice((shift, -shift, 0), (shift + 0.01, 0.01 - shift, 0.01))
        grid = run(DualContouring(), block, np.zeros(len(block)), components=1).label_grid
        multiples = grid.origin / grid.spacing
        assert np.allclose(multiples, np.rint(multiples), atol=1e-9)


@pytest.mark.parametrize("name", ["dual-contouring", "marching-cubes", "surface-nets"])
def test_meshers_are_plug_ins(name: str) -> None:
    """All meshers are registered and need no arguments."""
    assert isinstance(registry.load("meshers", name)(), Mesher)
