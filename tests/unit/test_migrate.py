"""`migrate` brings 1.0 datasets forward, changes no committed byte, and survives kill -9."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh

from doughdata.dataset import open_dataset, open_writer, validate
from doughdata.dataset.collect import collect
from doughdata.dataset.contacts import particle_contacts, piece_contacts
from doughdata.dataset.documents import dump_document
from doughdata.dataset.merge import merge
from doughdata.dataset.migrate import migrate
from doughdata.dataset.selection import SceneFilter
from doughdata.dataset.store import LocalStore
from doughdata.dataset.subset import subset
from doughdata.dataset.tables import refresh_tables
from doughschemas import (
    DamagedDatasetError,
    DatasetError,
    MissingLayerError,
    SceneGraph,
    VersionError,
)
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import STAGES, new_writer, write_examples

STORED = Path(__file__).parents[1] / "conformance/v1"
DERIVED = ("README.md", "croissant.json", "meta/info.json", "meta/stats.json")
KILLED = """
import os, signal, sys
from doughdata.dataset.migrate import migrate
from doughdata.dataset.store import LocalStore
method, left = sys.argv[2], [int(sys.argv[3])]
plain = getattr(LocalStore, method)
def deadly(self, path, data):
    result = plain(self, path, data)
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return result
setattr(LocalStore, method, deadly)
migrate(sys.argv[1])
"""


@pytest.fixture(params=["cubes", "retried"])
def old(request, tmp_path):
    """A copy of a stored dataset of format 1.0."""
    return Path(shutil.copytree(STORED / request.param / "dataset", tmp_path / request.param))


@pytest.fixture
def cubes(tmp_path):
    return Path(shutil.copytree(STORED / "cubes/dataset", tmp_path / "cubes"))


def hashes(folder: Path) -> dict[str, str]:
    """Path -> sha256 of every file that nobody may rebuild."""
    files = (path for path in folder.rglob("*") if path.is_file())
    names = {path.relative_to(folder).as_posix(): path for path in files}
    return {
        name: sha256(path.read_bytes()).hexdigest()
        for name, path in names.items()
        if name not in DERIVED and not (name.startswith("meta/") and name.endswith(".parquet"))
    }


def test_committed_files_stay(old):
    """Every committed file keeps its bytes, the fingerprint stays, deep validation is clean."""
    before, fingerprint = hashes(old), open_dataset(old).fingerprint
    found = migrate(old)
    assert (found.before, found.after) == ("1.0", "1.1")
    after = hashes(old)
    added = {name for name in after if name not in before}
    assert {name: after[name] for name in before} == before
    assert len(added) == found.supplements
    assert all(name.startswith("meta/supplements/") for name in added)
    assert open_dataset(old).fingerprint == fingerprint
    assert validate(old, deep=True).problems == ()


def test_newest_is_left_alone(old):
    """A second call writes nothing, and a dry run never does."""
    files = {path: path.stat().st_mtime_ns for path in old.rglob("*")}
    assert migrate(old, dry_run=True).changed
    assert {path: path.stat().st_mtime_ns for path in old.rglob("*")} == files
    migrate(old)
    files = {path: path.stat().st_mtime_ns for path in old.rglob("*")}
    assert not migrate(old).changed
    assert {path: path.stat().st_mtime_ns for path in old.rglob("*")} == files


@pytest.mark.parametrize(
    ("method", "after"), [("create", 1), ("create", 2), ("replace", 2), ("replace", 9)]
)
def test_kill_9(cubes, tmp_path, method, after):
    """Killed after any write, the dataset reads as before, and the same call goes on."""
    whole = Path(shutil.copytree(cubes, tmp_path / "whole"))
    migrate(whole)
    command = [sys.executable, "-c", KILLED, str(cubes), method, str(after)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    half = open_dataset(cubes)
    assert half.info["schema_version"] == "1.0"
    assert half.read_particles(1).positions.shape == (3, 240, 3)
    if after < 2:  # nobody has computed what touches what of the pieces
        with pytest.raises(MissingLayerError, match="doughdata migrate"):
            _ = half.frame(scene=1, frame=0).contacts
    if method == "create":  # no derived file was touched yet
        assert validate(cubes, deep=True).problems == ()
    found = migrate(cubes)
    assert found.kept == (after if method == "create" else 2)
    assert hashes(cubes) == hashes(whole)
    assert open_dataset(cubes).frames.equals(open_dataset(whole).frames)
    assert validate(cubes, deep=True).problems == ()


def test_nothing_is_computed_from_damage(cubes):
    """A flipped bit in what is read is named, and the dataset stays a 1.0 dataset."""
    (file,) = cubes.glob("data/sim/*/arrays.zarr/positions/c/0/0/0")
    data = bytearray(file.read_bytes())
    data[40] ^= 1
    file.write_bytes(data)
    with pytest.raises(DamagedDatasetError, match=r"positions/c/0/0/0 has changed"):
        migrate(cubes)
    assert open_dataset(cubes).info["schema_version"] == "1.0"
    assert not (cubes / "meta/supplements").exists()


def test_read_only_medium(cubes, monkeypatch):
    """Where nothing can be written one line says so, and nothing was half-written."""

    def refuse(self, path, data):
        raise DatasetError(f"{self.uri}: cannot write {path}: read-only file system")

    before = hashes(cubes)
    with monkeypatch.context() as patch:
        patch.setattr(LocalStore, "create", refuse)
        with pytest.raises(DatasetError, match="read-only file system"):
            migrate(cubes)
    assert hashes(cubes) == before


def test_what_an_older_release_adds_is_brought_forward(old):
    """A commit without the columns in a 1.1 dataset reads as null until `migrate` runs again."""
    migrate(old)
    frames = open_dataset(old).frames
    (old / "meta/supplements/1.1/sim/00000.0.json").unlink(missing_ok=True)
    (old / "meta/supplements/1.1/sim/00000.1.json").unlink(missing_ok=True)
    refresh_tables(LocalStore(old))
    assert open_dataset(old).frames["table_contacts"].null_count > 0
    assert validate(old, deep=True).problems == ()
    found = migrate(old)
    assert (found.before, found.supplements) == ("1.1", 1)
    assert open_dataset(old).frames.equals(frames)


def test_tables_that_an_older_release_rebuilt_are_rebuilt(old):
    """Derived tables without the newer columns are outdated, though every supplement is there."""
    plain = {path: path.read_bytes() for path in old.glob("meta/*.parquet")}
    migrate(old)
    frames = open_dataset(old).frames
    for path, data in plain.items():
        path.write_bytes(data)
    assert migrate(old, dry_run=True).outdated
    found = migrate(old)
    assert (found.supplements, found.changed) == (0, True)
    assert open_dataset(old).frames.equals(frames)
    assert validate(old, deep=True).problems == ()
    assert not migrate(old).changed


def test_a_wrong_tool_contact_is_found(cubes):
    """A flag that contradicts the stored counts is told by deep validation."""
    migrate(cubes)
    (path,) = cubes.glob("meta/supplements/1.1/sim/*.json")
    document = json.loads(path.read_text())
    flags = document["columns"]["tool_contact"]
    columns = {**document["columns"], "tool_contact": [not flag for flag in flags]}
    content = {name: value for name, value in document.items() if name != "sha256"}
    path.write_bytes(dump_document({**content, "columns": columns}))
    refresh_tables(LocalStore(cubes))
    assert any("tool_contact" in p.message for p in validate(cubes, deep=True).problems)


def test_a_dataset_keeps_its_version_until_it_is_migrated(old):
    """A refresh by this release leaves a 1.0 dataset a 1.0 dataset, to the last derived value."""
    tables = {path.name: pq.read_table(path) for path in old.glob("meta/*.parquet")}
    refresh_tables(LocalStore(old))
    assert open_dataset(old).info["schema_version"] == "1.0"
    for name, table in tables.items():
        found = pq.read_table(old / "meta" / name)
        assert found.equals(table), name
        assert found.schema.metadata == table.schema.metadata
    assert validate(old, deep=True).problems == ()


def test_a_scene_of_an_older_dataset_is_known_again(cubes):
    """The same user-written scenes are no other scenes for this release."""
    shards = open_writer(cubes).plan_scenes([cut_ring().scene, joined_bars().scene])
    assert [index for shard in shards for index in shard.scene_indices] == [0, 1]


def test_copies_of_older_datasets_are_whole(cubes, tmp_path):
    """Merge and subset give the columns of 1.1, as `migrate` would compute them."""
    ring = Path(subset(cubes, tmp_path / "ring", SceneFilter(scenes=(0,))).dataset)
    bars = subset(cubes, tmp_path / "bars", SceneFilter(scenes=(1,))).dataset
    merged = merge([ring, bars], tmp_path / "merged").dataset
    migrate(cubes)
    names = ["scene_index", "finger_contacts", "table_contacts", "touching_components"]
    expected = open_dataset(cubes).frames.select(names)
    assert open_dataset(merged).frames.select(names).equals(expected)
    assert not migrate(merged).changed
    assert validate(merged, deep=True).problems == ()


def test_newer_versions(tmp_path):
    """A newer minor version is read and validated, but neither written, migrated nor collected."""
    uri = write_examples(new_writer(tmp_path / "d")).uri
    path = tmp_path / "d/meta/info.json"
    info = json.loads(path.read_text())
    layers = [*info["layers"], "forces"]
    news = {**info, "schema_version": "1.9", "layers": layers, "news": [1]}
    path.write_bytes(dump_document(news))
    with pytest.warns(UserWarning, match=r"1\.9"):
        assert len(open_dataset(uri)) == 2
    with pytest.warns(UserWarning, match=r"1\.9"):
        problems = validate(uri, deep=True).problems
    # The footers of this hand-made dataset still say 1.1, nothing else is wrong.
    assert {problem.file.rpartition(".")[2] for problem in problems} <= {"parquet"}
    for refused in (open_writer, migrate, collect):
        with (
            pytest.warns(UserWarning, match=r"1\.9"),
            pytest.raises(VersionError, match="upgrade"),
        ):
            refused(uri)
    path.write_bytes(dump_document({**info, "schema_version": "2.0"}))
    with pytest.raises(VersionError, match=r"schema version 2\.0"):
        migrate(uri)


def test_validate_watches_supplements(cubes):
    """A changed, missing, misplaced or wrong supplement is named."""
    migrate(cubes)
    path = cubes / "meta/supplements/1.1/topology/00000.0.json"
    good = path.read_bytes()

    def problems():
        return [str(problem) for problem in validate(cubes, deep=True).problems]

    path.write_bytes(good.replace(b"false", b"true ", 1))
    assert any(p.startswith("meta/supplements/1.1/topology/00000.0.json") for p in problems())
    path.unlink()
    assert any(p.startswith("meta/frames.parquet") for p in problems())
    document = json.loads(good)
    path.write_bytes(dump_document({**document, "commit": "0" * 64}))
    assert any("does not belong to" in p for p in problems())
    stranger = path.with_name("00007.0.json")
    path.write_bytes(good)
    stranger.write_bytes(dump_document({**document, "shard": "00007"}))
    assert any("a commit that does not exist" in p for p in problems())
    stranger.unlink()
    columns = {**document["columns"], "touching_components": [0, 0, 3, 0, 0, 0]}
    path.write_bytes(dump_document({**document, "columns": columns}))
    refresh_tables(LocalStore(cubes))
    (told,) = problems()
    assert "touching_components is not what" in told
    assert told.endswith("[scene 0 frame 2, scene 1 frame 1]")


def test_pieces_that_touch():
    """Contacts within a component and between two are told apart; crumbs do not count."""
    graph = SceneGraph(
        positions=np.zeros((2, 3), np.float32),
        components=np.array([0, 1], np.uint8),
        particles=np.array([2, 2], np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    labels = np.array([0, 0, 1, 1, 2, 255], np.uint8)
    frame = replace(cut_ring().topology.frames[2], labels=labels, graph=graph, genus=(0, 0, 0))

    def found(*pairs):
        contacts = np.array(pairs, np.int32).reshape(-1, 2)
        columns = piece_contacts([replace(frame, contacts=contacts)])
        return columns["touching_components"][0], columns["self_contact"][0]

    assert found() == (0, False)
    assert found((0, 1)) == (0, True)
    assert found((0, 2), (3, 1)) == (1, False)
    assert found((0, 2), (4, 3), (2, 3)) == (2, True)
    assert found((0, 5)) == (0, False)


def test_a_mesh_finger_counts_as_the_box_that_it_is(tmp_path):
    """A box given as a mesh touches the particles that the box touches, in any pose."""
    ring = cut_ring()
    tool = replace(ring.scene.tools[0], width=0.006)
    box = trimesh.creation.box(extents=[tool.depth, tool.width, tool.height])
    box.apply_translation([tool.depth / 2, 0.0, tool.height / 2])
    box.export(tmp_path / "finger.stl")
    mesh = replace(tool, mesh=str(tmp_path / "finger.stl"))
    poses = ring.particles.tool_poses
    half = 0.3  # [rad]
    turned = np.array([[0, 0, np.sin(half), np.cos(half)], [0, 0, np.cos(half), -np.sin(half)]])
    poses = replace(poses, quaternion=np.tile(turned, (3, 1, 1)))
    particles = replace(ring.particles, tool_poses=poses)
    found = [
        particle_contacts(particles, replace(ring.scene, tools=(which,))) for which in (tool, mesh)
    ]
    assert found[0] == found[1]
    assert min(found[0]["finger_contacts"][2]) > 0


def test_contacts_do_not_depend_on_the_frame_of_reference(tmp_path):
    """Dough and fingers that are turned about z together touch as before."""
    ring = cut_ring()
    particles, angle = ring.particles, 0.7
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    z, w = np.sin(angle / 2), np.cos(angle / 2)
    q = particles.tool_poses.quaternion
    quaternion = np.stack(
        [
            w * q[..., 0] - z * q[..., 1],
            w * q[..., 1] + z * q[..., 0],
            w * q[..., 2] + z * q[..., 3],
            w * q[..., 3] - z * q[..., 2],
        ],
        axis=-1,
    )
    poses = replace(
        particles.tool_poses,
        position=particles.tool_poses.position @ turn.T,
        quaternion=quaternion,
    )
    positions = (particles.positions @ turn.T).astype(np.float32)
    turned = replace(particles, positions=positions, tool_poses=poses)
    assert particle_contacts(turned, ring.scene) == particle_contacts(particles, ring.scene)


def test_a_new_dataset_is_newest(tmp_path):
    """What this release writes needs no migration, and its stage records are of this version."""
    uri = write_examples(new_writer(tmp_path / "d")).uri
    assert not migrate(uri).changed
    assert open_dataset(uri).info["schema_version"] == "1.1"
    assert set(open_dataset(uri).info["stages"]) == set(STAGES)
