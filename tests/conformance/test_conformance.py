"""Stored datasets of every version are read for ever, with the values counted by hand."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.dataset import open_dataset, validate
from doughschemas import SEGMENT_COMPONENT, STRAY, MissingLayerError
from tests.conformance import make_v1_1
from tests.conformance.make_v1 import make

STORED = sorted(Path(__file__).parent.glob("v*/*/expected.json"))
SAMPLED = {"region", "duration", "tools", "parameters", "timestamp", "opening"}
CASES = [(f"{path.parent.parent.name}-{path.parent.name}", path.parent) for path in STORED]
CONTACTS = ("table_contacts", "finger_contacts", "touching_components", "self_contact")


@pytest.fixture(params=[path for _, path in CASES], ids=[name for name, _ in CASES])
def stored(request):
    expected = json.loads((request.param / "expected.json").read_text())
    return open_dataset(str(request.param / "dataset")), expected


def scenes(stored, key):
    """(scene_index, value) of all scenes for which a value is expected."""
    return [(int(i), s[key]) for i, s in stored[1]["scenes"].items() if key in s]


def test_there_are_stored_datasets():
    """Every version of the format has its two datasets, below 1 MB in sum."""
    assert {name for name, _ in CASES} == {
        *("v1-cubes", "v1-retried", "v1.1-cubes", "v1.1-migrated"),
    }
    for folder in Path(__file__).parent.glob("v*"):
        assert sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) < 1e6


def test_stored_datasets_are_valid(stored):
    """Deep validation finds no problem."""
    assert validate(stored[0].uri, deep=True).problems == ()


def test_structure(stored):
    """Version, layers, scene ids, key frames and failures are the expected ones."""
    dataset, expected = stored
    assert dataset.info["schema_version"] == expected["schema_version"]
    assert (dataset.num_frames, dataset.layers) == (expected["num_frames"], expected["layers"])
    assert [dataset.scene(i).scene_id for i in dataset.scene_indices] == expected["scene_ids"]
    for index, layers in expected.get("failed", {}).items():
        for layer, reason in layers.items():
            with pytest.raises(MissingLayerError, match=reason):
                dataset.layer(layer, int(index))


def test_particles_and_tools(stored):
    """Particle counts, the first particle's way, openings and times."""
    dataset, _ = stored
    for index, count in scenes(stored, "num_particles"):
        assert dataset.read_particles(index).positions.shape == (dataset.num_frames, count, 3)
    for index, way in scenes(stored, "first_particle"):
        assert np.allclose(dataset.read_particles(index).positions[:, 0], way, atol=1e-8)
    for index, opening in scenes(stored, "opening"):
        poses = dataset.read_particles(index).tool_poses
        assert np.allclose(poses.opening, opening)
        gap = np.linalg.norm(poses.position[:, 0] - poses.position[:, 1], axis=1)
        assert np.allclose(gap, opening)
    for index, times in scenes(stored, "timestamps"):
        assert np.allclose(dataset.read_particles(index).timestamps, times)


def test_topology(stored):
    """Genus, component sizes, scene graph, contacts, events and bonds."""
    dataset, _ = stored
    for index, genus in scenes(stored, "genus"):
        frames = dataset.read_topology(index).frames
        assert [list(frame.genus) for frame in frames] == genus
        assert not any(frame.ambiguous for frame in frames)
    for index, sizes in scenes(stored, "particles_of_component"):
        labels = [f.labels for f in dataset.read_topology(index).frames]
        assert not any((value == STRAY).any() for value in labels)
        assert [np.bincount(value).tolist() for value in labels] == sizes
    for index, events in scenes(stored, "events"):
        found = dataset.read_topology(index).events
        assert events == [
            [e.frame, e.kind, list(e.components_before), list(e.components_after)] for e in found
        ]
    counts = {
        "graph_nodes": lambda t: [len(f.graph.particles) for f in t.frames],
        "graph_edges": lambda t: [len(f.graph.edges) for f in t.frames],
        "contacts": lambda t: [len(f.contacts) for f in t.frames],
        "bonds_made": lambda t: [len(b) for b in t.bonds_made],
        "bonds_broken": lambda t: [len(b) for b in t.bonds_broken],
        "static_genus": lambda t: [list(genus) for genus in t.static_genus],
    }
    for key, count in counts.items():
        for index, expected in scenes(stored, key):
            assert count(dataset.read_topology(index)) == expected, key


def test_meshes(stored):
    """trimesh finds every mesh watertight, with the volume and Euler number of its cubes."""
    dataset, expected = stored
    if "mesh" not in expected["layers"]:
        with pytest.raises(MissingLayerError, match="--stages mesh"):
            dataset.read_meshes(0, 0)
    for index, volumes in scenes(stored, "mesh_volume"):
        euler = expected["scenes"][str(index)]["mesh_euler"]
        for k in range(dataset.num_frames):
            record = dataset.read_meshes(index, k)
            solids = [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in record.meshes]
            assert all(solid.is_watertight for solid in solids)
            assert [s.volume for s in solids] == pytest.approx(volumes[k], rel=1e-5)
            assert [s.euler_number for s in solids] == euler[k]
            nodes = np.bincount(record.label_grid.labels.ravel(), minlength=256)[: len(solids)]
            # A cube holds 2^3 nodes of a grid of half its side.
            assert nodes * record.label_grid.spacing**3 == pytest.approx(volumes[k], rel=1e-6)


def test_depth(stored):
    """The nearest point is the top of the highest cube, and dough is seen in every view."""
    dataset, _ = stored
    for index, least in scenes(stored, "least_depth"):
        views = dataset.read_depth(index, "none")
        near = views.depth.min(axis=(1, 2)) * views.depth_unit
        assert near == pytest.approx(least, abs=views.depth_unit / 2)
        assert (views.segments >= SEGMENT_COMPONENT).any(axis=(1, 2)).all()


def test_contacts(stored):
    """What touches what, in the table of key frames and in single frames; 1.0 names the command."""
    dataset, expected = stored
    if expected["schema_version"] == "1.0":
        assert not {*CONTACTS} & {*dataset.frames.column_names}
        with pytest.raises(MissingLayerError, match="doughdata migrate"):
            _ = dataset.frame(scene=0, frame=0).contacts
        return
    rows = dataset.frames.to_pylist()
    for key in CONTACTS:
        for index, values in scenes(stored, key):
            assert [row[key] for row in rows if row["scene_index"] == index] == values, key
    assert all(row["tool_contact"] == any(row["finger_contacts"]) for row in rows)
    for index, values in scenes(stored, "finger_contacts"):
        found = [dataset.frame(scene=index, frame=k).contacts for k in range(dataset.num_frames)]
        assert [list(contacts.fingers) for contacts in found] == values
        assert [c.table for c in found] == expected["scenes"][str(index)]["table_contacts"]
        assert [c.components for c in found] == expected["scenes"][str(index)]["touching_components"]


def test_the_writer_still_writes_this_format(tmp_path):
    """Today's writer gives datasets whose tables and particles equal the stored ones."""
    make(tmp_path / "v1")
    make_v1_1.make(tmp_path / "v1.1")
    for name in ("v1/cubes", "v1/retried", "v1.1/cubes", "v1.1/migrated"):
        old = open_dataset(str(Path(__file__).parent / f"{name}/dataset"))
        new = open_dataset(str(tmp_path / f"{name}/dataset"))
        for table in ("scenes", "frames", "topology_events", "graph_nodes", "views"):
            # What a family samples may change from release to release; the format may not.
            sampled = SAMPLED if name == "v1/retried" else set()
            kept = [c for c in old.table(table).column_names if c not in sampled]
            # A minor version adds columns and changes none.
            assert new.table(table).select(kept).equals(old.table(table).select(kept)), table
        for index in old.scene_indices:
            one, two = old.read_particles(index), new.read_particles(index)
            assert one.positions.tobytes() == two.positions.tobytes()
