"""The authors' `data.h5`, written and read back: equal in all that the format can hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doughdata.dataset import open_dataset, validate
from doughdata.exporters.doughnet_h5 import METRES_PER_UNIT, DoughnetH5
from doughdata.recordings.authors_h5 import AuthorsH5
from doughdata.recordings.authors_shapes import fit_gripper, schematic_graph, welded
from doughdata.scenes import finger_mesh, finger_poses
from doughschemas import (
    Action,
    BadInputError,
    ComponentMesh,
    DatasetError,
    MissingLayerError,
    Tool,
)
from tests.closed_form import NUM_FRAMES, SPACING, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
SIDES = np.array(list(np.ndindex(2, 2, 2)))
STEP = RING.scene.duration / (NUM_FRAMES - 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The examples as a dataset `d`, exported to `data.h5` and imported again to `again`."""
    folder = tmp_path_factory.mktemp("h5")
    write_examples(new_writer(folder / "d"))
    DoughnetH5().export(open_dataset(folder / "d"), [0, 1], folder / "data.h5")
    AuthorsH5().convert(
        folder / "data.h5", str(folder / "again"), points=400, seconds_per_frame=STEP
    )
    return folder


def triangles(mesh: ComponentMesh) -> np.ndarray:
    """A mesh's triangles in micrometres, each begun with its least corner, sorted."""
    corners = np.rint(mesh.vertices[mesh.faces] * 1e6).astype(int)
    first = [min(range(3), key=lambda k, t=t: tuple(t[k])) for t in corners]
    turned = [np.roll(t, -k, axis=0).ravel() for t, k in zip(corners, first, strict=True)]
    return np.array(sorted(map(tuple, turned)))


def test_the_file_is_laid_out_as_the_authors_do(folder: Path) -> None:
    """Names, shapes and dtypes are those that their loader indexes; lengths are in units of
    0.2 m, labels begin at 1 and every triangle has one label."""
    import h5py

    with h5py.File(folder / "data.h5") as file:
        data = {name: values[:] for name, values in file.items()}
    faces = data["obj_faces"].shape[2]
    shape = {
        "scene": (),
        "frame": (),
        "genus": (5,),
        "obj_verts": (3 * faces, 3),
        "obj_faces": (faces, 3),
        "obj_vert_labels": (3 * faces, 1),
        "obj_face_labels": (faces, 1),
        "ee_verts": (192, 3),
        "ee_faces": (64, 3),
        "ee_observed": (1024, 3),
    }
    assert {name: values.shape for name, values in data.items()} == {
        name: (2, NUM_FRAMES, *tail) for name, tail in shape.items()
    }
    kinds = {np.dtype(np.int32), np.dtype(np.float32)}
    assert {values.dtype for values in data.values()} <= kinds
    assert np.array_equal(data["obj_faces"][1, 2].ravel(), np.arange(3 * faces))
    assert data["genus"][0].tolist() == [
        [-1, 1, -1, -1, -1],
        [-1, 0, -1, -1, -1],
        [-1, 0, 0, -1, -1],
    ]
    assert set(data["obj_face_labels"][0, 2].ravel()) == {1, 2}
    assert np.array_equal(data["obj_vert_labels"][:, :, ::3], data["obj_face_labels"])
    reach = data["obj_verts"][0, 0].max(axis=0) * METRES_PER_UNIT
    np.testing.assert_allclose(reach, RING.meshes[0].meshes[0].vertices.max(axis=0), rtol=1e-6)


def test_observed_points_lie_on_the_fingers(folder: Path) -> None:
    """The 1024 points lie on the surface of both fingers, up to the height that is observed."""
    import h5py

    with h5py.File(folder / "data.h5") as file:
        seen = file["ee_observed"][0, 1] * METRES_PER_UNIT
    tools = open_dataset(folder / "d").frame(scene=0, frame=1).tools
    half = len(seen) // 2
    for finger, points in enumerate((seen[:half], seen[half:])):
        away = (points[:, 0] - tools.position[finger, 0]) * (1 if finger == 0 else -1)
        box = np.column_stack([away - 0.005, points[:, 1], points[:, 2] - 0.015])
        edge = np.abs(box) / [0.005, 0.005, 0.015]
        np.testing.assert_allclose(edge.max(axis=1), 1.0, atol=1e-4)


def test_all_that_the_format_holds_comes_back(folder: Path) -> None:
    """Triangles to a micrometre, genus, fingers and times equal those that were exported; the
    imported dataset passes the deep validation."""
    assert validate(folder / "again", deep=True).problems == ()
    old, new = open_dataset(folder / "d"), open_dataset(folder / "again")
    for scene in (0, 1):
        for k in range(NUM_FRAMES):
            before, after = (d.frame(scene=scene, frame=k) for d in (old, new))
            assert after.topology.genus == before.topology.genus
            assert after.timestamp == pytest.approx(before.timestamp)
            assert len(after.meshes) == len(before.meshes)
            for one, other in zip(before.meshes, after.meshes, strict=True):
                assert np.array_equal(triangles(one), triangles(other))
            np.testing.assert_allclose(after.tools.position, before.tools.position, atol=1e-7)
            np.testing.assert_allclose(after.tools.quaternion, before.tools.quaternion, atol=1e-6)
            size = [
                (t.tool.depth, t.tool.width, t.tool.height) for t in (before.tools, after.tools)
            ]
            assert size[1] == pytest.approx(size[0])


def test_points_and_grid_lie_in_the_meshes(folder: Path) -> None:
    """Every drawn point lies in a cube of its component, as many to a volume as in any other; the
    label grid says the same at its nodes."""
    new = open_dataset(folder / "again")
    frame = new.frame(scene=0, frame=2)
    cells = np.floor(RING.particles.positions[2] / SPACING).astype(int)
    owner = {
        tuple(c): k for c, k in zip(cells.tolist(), RING.topology.frames[2].labels, strict=True)
    }
    own = np.floor(frame.particles.positions / SPACING).astype(int).tolist()
    assert [owner[tuple(cell)] for cell in own] == frame.topology.labels.tolist()
    assert np.bincount(frame.topology.labels).tolist() == [200, 200]
    grid = frame.label_grid
    for node in np.ndindex(*grid.labels.shape):  # nodes at corners of cubes: all eight around
        corner = np.rint((grid.origin + np.array(node) * grid.spacing) / SPACING).astype(int)
        around = {owner.get(tuple((corner - side).tolist()), 255) for side in SIDES}
        assert grid.labels[node] in around


@pytest.mark.parametrize("genus", [(0,), (1,), (3, 0), (0, 2, 1)])
def test_the_schematic_graph_has_the_right_topology(genus: tuple[int, ...]) -> None:
    """Each component is connected and edges - nodes + 1 is its genus, by networkx's count."""
    import networkx as nx

    labels = np.repeat(np.arange(len(genus)), 20).astype(np.uint8)
    points = np.random.default_rng(0).random((len(labels), 3)).astype(np.float32)
    graph = schematic_graph(points, labels, genus)
    network = nx.Graph()
    network.add_nodes_from(range(len(graph.components)))
    network.add_edges_from(map(tuple, graph.edges.tolist()))
    parts = list(nx.connected_components(network))
    assert len(parts) == len(genus)
    for part in parts:
        (label,) = set(graph.components[list(part)].tolist())
        assert len(nx.cycle_basis(network.subgraph(part))) == genus[label]


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, 3.1])
def test_fingers_are_fitted_in_any_pose(yaw: float) -> None:
    """From the triangles of two boxes come back the pose, the opening and the size."""
    tool = Tool(name="t", depth=0.012, width=0.03, height=0.04)
    position, quaternion = finger_poses(Action(position=(0.01, -0.02), yaw=yaw), 0.025)
    mesh = finger_mesh(tool)
    corners = np.asarray(mesh.vertices)[mesh.faces].reshape(-1, 3)
    turn = 2 * np.arctan2(quaternion[:, 2], quaternion[:, 3])
    posed = []
    for angle, place in zip(turn, position, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        posed.append(corners @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + place)
    found = fit_gripper(np.concatenate(posed))
    assert found.middle == pytest.approx((0.01, -0.02), abs=1e-6)
    assert np.cos(found.yaw - yaw) == pytest.approx(1.0)
    assert found.opening == pytest.approx(0.025, abs=1e-6)
    assert found.size == pytest.approx((0.012, 0.03, 0.04), abs=1e-6)


def test_welding_undoes_the_list_of_triangles() -> None:
    """A closed mesh that was stored corner by corner, with triangles without area behind it, is
    that mesh again."""
    mesh = RING.meshes[0].meshes[0]
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    padded = np.concatenate([corners, np.repeat(corners[:1], 30, axis=0)])
    again = welded(padded)
    assert len(again.vertices) == len(mesh.vertices)
    assert np.array_equal(triangles(again), triangles(mesh))


def test_groups_are_splits_and_the_rest_is_told(folder: Path, tmp_path: Path) -> None:
    """Groups of one file become splits; one of observed points alone is a loss with its reason,
    and so is a scene whose mesh is open."""
    import h5py

    with h5py.File(folder / "data.h5") as file, h5py.File(tmp_path / "dataset.h5", "w") as new:
        for name in ("train", "val_test"):
            for key, values in file.items():
                new.create_dataset(f"{name}/{key}", data=values[:])
        verts = new["val_test/obj_verts"]
        verts[1, 0, :3] = verts[1, 0, 3:6]
        new.create_dataset("real/obj_observed", data=np.zeros((4, 3, 10, 4)))
        new.create_dataset("real/scene", data=np.zeros((4, 3), np.int32))
    done = AuthorsH5().convert(
        tmp_path / "dataset.h5", str(tmp_path / "d"), points=200, seconds_per_frame=STEP
    )
    scenes = open_dataset(tmp_path / "d").scenes
    assert scenes["split"].to_pylist() == ["train", "train", "test"]
    assert [(loss.where, loss.count) for loss in done.losses] == [
        ("real", 4),
        ("dataset-val_test-000001", 1),
    ]
    assert "not closed" in done.losses[1].reason


def test_the_same_import_resumes(folder: Path, tmp_path: Path) -> None:
    """A second call writes nothing new; another number of points is refused by name."""
    arguments = (folder / "data.h5", str(tmp_path / "d"))
    AuthorsH5().convert(*arguments, points=100, seconds_per_frame=STEP)
    before = open_dataset(tmp_path / "d").fingerprint
    files = sorted(tmp_path.rglob("*"))
    AuthorsH5().convert(*arguments, points=100, seconds_per_frame=STEP)
    assert (open_dataset(tmp_path / "d").fingerprint, sorted(tmp_path.rglob("*"))) == (
        before,
        files,
    )
    with pytest.raises(DatasetError, match=r"sim\.points = 100"):
        AuthorsH5().convert(*arguments, points=200, seconds_per_frame=STEP)


def test_bad_requests_leave_nothing(folder: Path, tmp_path: Path) -> None:
    """A path of another kind, too few triangles, a scene without meshes, a file that is no HDF5:
    each is one line, and nothing is written."""
    opened = open_dataset(folder / "d")
    with pytest.raises(BadInputError, match=r"ends in \.h5"):
        DoughnetH5().export(opened, [0], tmp_path / "data.zip")
    with pytest.raises(BadInputError, match="more than faces=10"):
        DoughnetH5().export(opened, [0], tmp_path / "data.h5", faces=10)
    write_examples(new_writer(tmp_path / "bare"), [RING], layers=("sim",))
    with pytest.raises(MissingLayerError, match="--stages mesh"):
        DoughnetH5().export(open_dataset(tmp_path / "bare"), [0], tmp_path / "data.h5")
    (tmp_path / "text.h5").write_text("no")
    assert not AuthorsH5().takes(tmp_path / "text.h5")
    assert AuthorsH5().takes(folder / "data.h5")
    with pytest.raises(BadInputError, match="cannot be read as HDF5"):
        AuthorsH5().convert(tmp_path / "text.h5", str(tmp_path / "new"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare", "text.h5"]


def test_more_components_than_the_format_holds_are_refused(tmp_path: Path) -> None:
    """Five pieces do not fit into labels 1 to 4: told, with the key frame."""
    frame = RING.topology.frames[0]
    piece = RING.meshes[2].meshes[0]
    many = replace(RING.meshes[0], meshes=(piece,) * 5)
    topology = replace(
        RING.topology, frames=(replace(frame, genus=(0,) * 5), *RING.topology.frames[1:])
    )
    example = replace(RING, topology=topology, meshes=(many, *RING.meshes[1:]))
    write_examples(new_writer(tmp_path / "d"), [example])
    with pytest.raises(BadInputError, match=r"frame=0.*holds 4 components, got 5"):
        DoughnetH5().export(open_dataset(tmp_path / "d"), [0], tmp_path / "data.h5")
    assert not (tmp_path / "data.h5").exists()
