"""`validate` finds every flipped byte and every broken promise, and nothing else."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.dataset import DatasetWriter, open_writer, validate
from doughdata.dataset.arrays import ShardedArray
from doughdata.dataset.graphs import component_count, mesh_genus, mesh_volume, mesh_watertight
from doughschemas import DamagedDatasetError, DatasetError, FrameTopology, SceneGraph
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import STAGES, new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "dataset"
    write_examples(new_writer(path, scenes_per_shard=2))
    return path


@pytest.fixture
def dataset(stored, tmp_path):
    return Path(shutil.copytree(stored, tmp_path / "dataset"))


def flip(path: Path, position: int, bit: int = 0) -> bytes:
    """Flip one bit of a file; returns what was there."""
    data = path.read_bytes()
    changed = bytearray(data)
    changed[position] ^= 1 << bit
    path.write_bytes(changed)
    return data


def test_whole_dataset_has_no_problem(stored):
    """A dataset as it was written is valid, and its figures are those of the closed form."""
    report = validate(str(stored), deep=True)
    assert report.problems == ()
    assert report.figures["mesh_genus_agreement"] == 1.0
    assert report.figures["ambiguous_share"] == 0.0
    assert report.figures["volume_error_max"] < 1e-5
    assert (report.figures["total_scenes"], report.figures["orphans"]) == (2, 0)
    files = [p for p in (stored / "data").rglob("*") if p.is_file()]
    assert report.figures["files"] == len(files)
    assert report.figures["bytes"] == sum(p.stat().st_size for p in files)


def test_every_file_is_watched(dataset):
    """One flipped bit in any file of the dataset, wherever it lies, is found and named."""
    rng = np.random.default_rng(0)
    files = sorted(p for p in dataset.rglob("*") if p.is_file())
    assert len(files) > 50
    for path in files:
        data = flip(path, int(rng.integers(path.stat().st_size)), int(rng.integers(8)))
        report = validate(str(dataset))
        path.write_bytes(data)
        name = path.relative_to(dataset).as_posix()
        assert name in {p.file for p in report.problems}, name
    assert validate(str(dataset)).ok


@pytest.mark.parametrize(
    ("layer", "array"), [("sim", "positions"), ("mesh", "label_grid"), ("depth.none", "depth")]
)
def test_damage_in_a_row_names_its_frame(dataset, layer, array):
    """A flipped byte in a row's chunk names scene and key frame; deep alone looks that close."""
    (folder,) = (dataset / f"data/{layer}").glob(f"*/arrays.zarr/{array}")
    opened = ShardedArray(folder)
    row = 4  # both scenes have three key frames and lie in one shard
    offset, size = (int(v) for v in opened.index[row])
    flip(opened.file, offset + size // 2)
    (found,) = validate(str(dataset), deep=True).problems
    assert found.file == opened.file.relative_to(dataset).as_posix()
    assert found.frames == ((1, 1),)
    assert "scene 1 frame 1" in str(found)
    with pytest.raises(DamagedDatasetError, match="crc32c"):
        opened.row(row)


def test_every_byte_of_a_chunk_is_under_its_checksum(dataset):
    """The reader itself refuses a row if any one byte of its chunk, checksum included, differs."""
    (folder,) = (dataset / "data/topology").glob("*/arrays.zarr/labels")
    opened = ShardedArray(folder)
    offset, size = (int(v) for v in opened.index[0])
    for position in range(offset, offset + size):
        data = flip(opened.file, position, position % 8)
        with pytest.raises(DamagedDatasetError):
            opened.row(0)
        opened.file.write_bytes(data)
    assert opened.row(0)[0] == 0


def test_missing_strange_and_stale_things_are_named(dataset):
    """A missing file, a stranger in an attempt and an orphan: the first two are problems."""
    attempt = next((dataset / "data/mesh").iterdir())
    (attempt / "arrays.zarr/faces/zarr.json").unlink()
    (attempt / "notes.txt").write_text("mine")
    shutil.copytree(attempt, attempt.parent / "00000-0123456789ab")
    report = validate(str(dataset))
    found = {(Path(p.file).name, p.message) for p in report.problems}
    assert found == {("zarr.json", "is missing"), ("notes.txt", "is not named by the commit")}
    assert report.figures["orphans"] == 1


def test_an_upstream_that_changed_makes_layers_stale(dataset):
    """After a new `topology` revision the mesh and depth layers are reported, with the command."""
    writer = open_writer(str(dataset))
    (task,) = writer.tasks("topology", replace_with=replace(STAGES["topology"], name="other"))
    records = {0: RING.topology, 1: BARS.topology}
    writer.write(task, records, stage=STAGES["topology"])
    writer.refresh()
    problems = validate(str(dataset)).problems
    assert {p.file for p in problems} == {
        "meta/commits/mesh/00000.0.json",
        "meta/commits/depth.none/00000.0.json",
    }
    assert any("doughdata generate --stages mesh" in p.message for p in problems)


def test_derived_tables_must_be_a_rebuild(dataset):
    """A derived table that differs from the commits is a problem; a refresh puts it right."""
    (dataset / "meta/views.parquet").write_bytes((dataset / "meta/frames.parquet").read_bytes())
    (found,) = validate(str(dataset)).problems
    assert found.file == "meta/views.parquet"
    open_writer(str(dataset)).refresh()
    assert validate(str(dataset)).ok


def test_no_dataset_is_an_error_not_a_report(tmp_path):
    """An empty folder cannot be validated."""
    with pytest.raises(DatasetError, match="is not a dataset"):
        validate(str(tmp_path))


def rewritten(tmp_path, **changes) -> list[str]:
    """Messages of a deep validation of the ring with some records replaced."""
    writer: DatasetWriter = new_writer(tmp_path / "changed")
    write_examples(writer, [replace(RING, **changes)])
    return [p.message for p in validate(writer.uri, deep=True).problems]


def with_frame(frame: FrameTopology):
    """The ring's topology with another first frame."""
    return {"topology": replace(RING.topology, frames=(frame, *RING.topology.frames[1:]))}


FIRST = RING.topology.frames[0]


@pytest.mark.parametrize(
    ("graph", "message"),
    [
        ({"edges": [[0, 1], [1, 2], [2, 3]]}, "genus as cycle rank"),
        ({"edges": [[0, 1], [0, 1], [2, 3], [1, 2]]}, "double edges"),
        ({"edges": [[0, 0], [0, 1], [1, 2], [2, 3]]}, "no loops"),
        ({"edges": [[0, 9]]}, "names a node that does not exist"),
        ({"components": [0, 0, 0, 1]}, "joins two components"),
    ],
)
def test_broken_scene_graphs_are_found(tmp_path, graph, message):
    """Edges must be valid, within a component, and give the genus as cycle rank."""
    changes = {k: np.array(v, getattr(FIRST.graph, k).dtype) for k, v in graph.items()}
    broken: SceneGraph = replace(FIRST.graph, **changes)
    messages = rewritten(tmp_path, **with_frame(replace(FIRST, graph=broken)))
    assert any(message in m for m in messages), messages


def test_broken_labels_and_contacts_are_found(tmp_path):
    """A label without a component and a contact without a particle are problems."""
    labels = FIRST.labels.copy()
    labels[3] = 7
    contacts = np.array([[0, 144]], np.int32)
    messages = rewritten(tmp_path, **with_frame(replace(FIRST, labels=labels, contacts=contacts)))
    assert any("labels must be" in m for m in messages)
    assert any("contact names a particle" in m for m in messages)


def test_broken_meshes_are_found(tmp_path):
    """A hole, a mesh too many and a mesh turned inside out are problems."""
    last = RING.meshes[-1]
    for change, message in (
        (lambda m: replace(m, faces=m.faces[1:]), "not watertight"),
        (lambda m: replace(m, faces=m.faces[:, ::-1].copy()), "inside out"),
        (lambda m: replace(m, vertices=m.vertices * np.float32(1.02)), "off the particles' volume"),
        (lambda m: replace(m, vertices=m.vertices * np.float32(np.nan)), "not finite"),
    ):
        meshes = replace(last, meshes=tuple(change(m) for m in last.meshes))
        folder = tmp_path / message.replace("'", "")
        messages = rewritten(folder, meshes=(*RING.meshes[:-1], meshes))
        assert any(message in m for m in messages), (message, messages)


def test_broken_numbers_are_found(tmp_path):
    """A particle at infinity, a time that stands still and a stretched quaternion are problems."""
    particles = RING.particles
    positions = particles.positions.copy()
    positions[1, 5, 0] = np.inf
    poses = replace(particles.tool_poses, quaternion=particles.tool_poses.quaternion * 1.01)
    broken = replace(
        particles, positions=positions, timestamps=particles.timestamps * 0, tool_poses=poses
    )
    messages = rewritten(tmp_path, particles=broken)
    for message in ("must be finite and as many", "timestamps must rise", "unit quaternions"):
        assert any(message in m for m in messages), messages


def test_report_is_plain_json(dataset):
    """The report of a damaged dataset survives a JSON round trip with frames and figures."""
    (folder,) = (dataset / "data/sim").glob("*/arrays.zarr/positions")
    opened = ShardedArray(folder)
    flip(opened.file, int(opened.index[0][0]))
    report = validate(str(dataset), deep=True).to_json()
    assert json.loads(json.dumps(report)) == report
    assert report["ok"] is False
    assert report["problems"][0]["frames"] == [{"scene_index": 0, "frame_index": 0}]


@pytest.mark.parametrize(
    ("solid", "genus"),
    [
        (trimesh.creation.icosphere(subdivisions=1), 0),
        (trimesh.creation.torus(major_radius=2, minor_radius=0.5), 1),
        (trimesh.creation.annulus(r_min=1, r_max=2, height=1), 1),
        (trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.torus(9, 3)]), 1),
    ],
)
def test_mesh_counts_agree_with_trimesh(solid, genus):
    """Watertightness and volume are trimesh's; the genus is the solid's."""
    vertices, faces = np.asarray(solid.vertices), np.asarray(solid.faces)
    assert mesh_watertight(faces, len(vertices)) == solid.is_watertight
    assert mesh_volume(vertices, faces) == pytest.approx(solid.volume)
    assert mesh_genus(faces) == genus
    assert not mesh_watertight(faces[1:], len(vertices))


def test_component_count_agrees_with_scipy():
    """Random graphs have as many components as scipy counts."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rng = np.random.default_rng(0)
    for _ in range(50):
        nodes, count = int(rng.integers(1, 60)), int(rng.integers(0, 60))
        edges = rng.integers(0, nodes, (count, 2))
        matrix = coo_array((np.ones(count), edges.T), shape=(nodes, nodes))
        assert component_count(edges, nodes) == connected_components(matrix)[0]
