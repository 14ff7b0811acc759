"""Records to disk and back, and what clients that are not ours see."""

import json

import duckdb
import numpy as np
import pytest
import tensorstore
import zarr

from doughdata.dataset import open_dataset, reader
from doughdata.dataset.arrays import ShardedArray, padded_length
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import equal, new_writer, write_examples

EXAMPLES = [cut_ring(), joined_bars()]


@pytest.fixture(scope="module", params=[1, 2], ids=["shard-a-scene", "one-shard"])
def dataset(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("layers") / "dataset"
    write_examples(new_writer(path, scenes_per_shard=request.param), EXAMPLES)
    return open_dataset(str(path))


def arrays(dataset):
    """Folders of all arrays of the dataset."""
    return sorted(p.parent for p in dataset._store.local("data").rglob("*/arrays.zarr/*/zarr.json"))


@pytest.mark.parametrize("index", [0, 1])
def test_whole_scenes_come_back_bit_for_bit(dataset, index):
    """What a stage wrote is what the next stage reads: every value, dtype and shape."""
    example = EXAMPLES[index]
    assert equal(dataset.read_particles(index), example.particles)
    assert equal(dataset.read_topology(index), example.topology)
    assert equal(dataset.read_depth(index, "none"), example.depth)
    for k in range(NUM_FRAMES):
        assert equal(dataset.read_meshes(index, k), example.meshes[k])
    assert dataset.scene(index) == example.scene


@pytest.mark.parametrize("index", [0, 1])
def test_frames_show_the_same_values(dataset, index):
    """A frame's parts are the rows of the records that were written."""
    example = EXAMPLES[index]
    for k in range(NUM_FRAMES):
        frame = dataset.frame(scene=index, frame=k)
        assert np.array_equal(frame.particles.positions, example.particles.positions[k])
        assert frame.genus == example.topology.frames[k].genus
        assert equal(frame.topology, example.topology.frames[k])
        assert equal(frame.meshes, example.meshes[k].meshes)
        assert equal(frame.label_grid, example.meshes[k].label_grid)
        assert frame.events == tuple(e for e in example.topology.events if e.frame == k)
        assert frame.timestamp == example.particles.timestamps[k]
        assert np.array_equal(frame.tools.position, example.particles.tool_poses.position[k])
        assert frame.tools.tool == example.scene.tools[0]
        assert np.array_equal(frame.depth("none").depth[0], example.depth.depth[k])


def test_what_is_kept_in_memory_is_bounded(dataset, monkeypatch):
    """Layers over the limit are forgotten and read again; what was decoded counts as memory."""
    shard = open_dataset(dataset.uri).layer("sim", 0)
    frames = shard.table("frames")
    before = shard.nbytes
    decoded = frames.values("timestamp", slice(0, NUM_FRAMES))
    assert shard.nbytes >= before + decoded.nbytes
    monkeypatch.setattr(reader, "OPEN_LEAST", 2)
    monkeypatch.setattr(reader, "OPEN_BYTES", 1)
    bounded = open_dataset(dataset.uri)
    for _ in range(2):
        for index, example in enumerate(EXAMPLES):
            frame = bounded.frame(scene=index, frame=1)
            assert equal(frame.topology, example.topology.frames[1])
            assert np.array_equal(frame.particles.positions, example.particles.positions[1])
            assert equal(frame.label_grid, example.meshes[1].label_grid)
            assert len(bounded._here.shards) <= 3


def test_zarr_and_tensorstore_read_the_same_arrays(dataset):
    """Two independent Zarr clients and the direct reader agree on every array, byte for byte."""
    found = arrays(dataset)
    assert len({p.name for p in found}) == 14
    for folder in found:
        ours = ShardedArray(folder)
        assert ours.chunk is not None, "the direct reader must not need its fallback"
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": f"{folder}/"}}
        theirs = tensorstore.open(spec, open=True, read=True).result().read().result()
        plain = zarr.open_array(folder, mode="r")[:]
        assert ours.all().tobytes() == theirs.tobytes() == np.asarray(plain).tobytes()


def test_rows_follow_from_the_tables_alone(dataset):
    """frames.parquet, a commit record and a Zarr client are enough to find a frame's labels."""
    root = dataset._store.local("")
    where = "where scene_index = 1 and frame_index = 2"
    query = f"select shard, row, num_particles from '{root}/meta/frames.parquet' {where}"
    shard, row, count = duckdb.sql(query).fetchall()[0]
    commits = sorted((root / "meta/commits/topology").glob(f"{shard}.*.json"))
    commit = json.loads(commits[-1].read_text())
    labels = zarr.open_array(root / commit["path"] / "arrays.zarr/labels", mode="r")
    assert np.array_equal(labels[row, :count], EXAMPLES[1].topology.frames[2].labels)


def test_duckdb_reads_every_table(dataset):
    """DuckDB opens all derived tables; frames lists every key frame with components and genus."""
    meta = dataset._store.local("meta")
    counts = {
        path.stem: duckdb.sql(f"select count(*) from '{path}'").fetchall()[0][0]
        for path in meta.glob("*.parquet")
    }
    events = sum(len(e.topology.events) for e in EXAMPLES)
    graphs = [f.graph for e in EXAMPLES for f in e.topology.frames]
    assert counts == {
        "scenes": 2,
        "frames": 2 * NUM_FRAMES,
        "topology_events": events,
        "graph_nodes": sum(len(g.particles) for g in graphs),
        "graph_edges": sum(len(g.edges) for g in graphs),
        "tool_poses": 2 * NUM_FRAMES * 2,
        "views": 2 * NUM_FRAMES,
    }
    columns = "scene_index, frame_index, num_components, genus"
    rows = duckdb.sql(f"select {columns} from '{meta}/frames.parquet' order by index").fetchall()
    assert rows == [
        (i, k, frame.num_components, list(frame.genus))
        for i, example in enumerate(EXAMPLES)
        for k, frame in enumerate(example.topology.frames)
    ]


def test_lengths_are_padded_for_bitshuffle(dataset):
    """Ragged axes are multiples of 8, at least 8, and never shorter than the data."""
    assert [padded_length(n) for n in (0, 1, 8, 9, 16)] == [8, 8, 8, 16, 16]
    for folder in arrays(dataset):
        array = ShardedArray(folder)
        if folder.name in ("positions", "labels", "vertices", "faces"):
            assert array.shape[1] % 8 == 0
