"""The whole path on three small scenes, by the commands."""

import json
import shutil
from pathlib import Path

import duckdb
import numpy as np
import pytest
import tensorstore
import trimesh

import doughdata
from tests.integration.conftest import FRAMES, command


def test_the_dataset_validates(tiny_dataset: Path) -> None:
    """A dataset made by the commands has no problem, on the surface and deep down."""
    for options in ((), ("--deep",)):
        done = command("validate", "--json", *options, "--dataset", tiny_dataset, cwd=tiny_dataset)
        found = json.loads(done.stdout)
        assert found["ok"]
        assert found["problems"] == []


def test_topology_of_plain_scenes(tiny_dataset: Path) -> None:
    """Rolls apart are two; a roll that a blade cuts is two; an untouched ring has one hole."""
    ds = doughdata.open_dataset(str(tiny_dataset))
    ids = ds.scenes["scene_id"].to_pylist()
    frames = {
        name: (ds.frame(scene=i, frame=0), ds.frame(scene=i, frame=FRAMES - 1))
        for i, name in enumerate(ids)
    }
    topology = {
        name: [(f.topology.num_components, f.topology.genus) for f in pair]
        for name, pair in frames.items()
    }
    assert topology["two-rolls"][0] == (2, (0, 0))
    assert topology["cut-roll"] == [(1, (0,)), (2, (0, 0))]
    assert topology["ring"][0] == (1, (1,))


def test_final_meshes_are_closed_and_keep_the_volume(tiny_dataset: Path) -> None:
    """Final meshes are watertight for trimesh and hold the particles' volume within 5 %."""
    ds = doughdata.open_dataset(str(tiny_dataset))
    for scene in range(len(ds)):
        frame = ds.frame(scene=scene, frame=FRAMES - 1)
        particles = ds.read_particles(scene)
        solids = [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in frame.meshes]
        assert len(solids) == frame.topology.num_components
        assert all(solid.is_watertight for solid in solids)
        kept = (frame.topology.labels != 255).sum()
        volume = sum(solid.volume for solid in solids)
        assert volume == pytest.approx(kept * particles.spacing**3, rel=0.05)


def test_depth_sees_the_dough(tiny_dataset: Path) -> None:
    """Ideal depth of dough pixels lies on the meshes, and noise leaves most pixels near it."""
    from doughdata.geometry import points_from_depth

    ds = doughdata.open_dataset(str(tiny_dataset))
    frame = ds.frame(scene=0, frame=5)
    ideal, noisy = frame.depth("none"), frame.depth("realsense")
    dough = ideal.segments[0] >= 16
    assert dough.sum() > 100
    depth = ideal.depth[0].astype(np.float32) * np.float32(ideal.depth_unit)
    points = points_from_depth(depth, ideal.cameras[0], dough)
    solids = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces) for m in frame.meshes])
    low, high = solids.bounds
    assert ((points > low - 2e-3) & (points < high + 2e-3)).all()
    both = dough & (noisy.depth[0] > 0)
    error = (noisy.depth[0][both].astype(float) - ideal.depth[0][both]) * ideal.depth_unit
    assert both.sum() > 0.5 * dough.sum()
    assert 1e-5 < np.median(np.abs(error)) < 2e-3


def test_duckdb_reads_the_tables(tiny_dataset: Path) -> None:
    """DuckDB lists every key frame with its number of components and genus."""
    rows = duckdb.sql(
        f"select scene_index, count(*), min(num_components), min(len(genus)) "
        f"from '{tiny_dataset}/meta/frames.parquet' group by scene_index order by scene_index"
    ).fetchall()
    assert [row[:2] for row in rows] == [(0, FRAMES), (1, FRAMES), (2, FRAMES)]
    assert all(c >= 1 and genus >= 1 for _, _, c, genus in rows)


def test_tensorstore_reads_what_we_read(tiny_dataset: Path) -> None:
    """With the tables and the commit record alone, another Zarr client reads the same arrays."""
    ds = doughdata.open_dataset(str(tiny_dataset))
    shard, row = duckdb.sql(
        f"select shard, row from '{tiny_dataset}/meta/frames.parquet' "
        "where scene_index = 1 and frame_index = 5"
    ).fetchall()[0]
    commit = json.loads((tiny_dataset / "meta" / "commits" / "sim" / f"{shard}.0.json").read_text())
    where = tiny_dataset / commit["path"] / "arrays.zarr" / "positions"
    store = tensorstore.open(
        {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(where)}}
    ).result()
    ours = ds.frame(scene=1, frame=5).particles.positions
    np.testing.assert_array_equal(store[row].read().result()[: len(ours)], ours)


def test_a_contact_sheet_is_saved(tiny_dataset: Path, tmp_path: Path) -> None:
    """`view` saves a picture of a useful size and prints where."""
    from PIL import Image

    done = command(
        "view", "--save", tmp_path / "sheet.png", "--dataset", tiny_dataset, cwd=tmp_path
    )
    assert done.stdout.strip() == str(tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        assert min(image.size) > 400
        assert len(np.unique(np.asarray(image.convert("L")))) > 50


def test_info_and_stats_agree_with_the_tables(tiny_dataset: Path) -> None:
    """Both commands count what the dataset holds."""
    where = ("--json", "--dataset", tiny_dataset)
    info = json.loads(command("info", *where, cwd=tiny_dataset).stdout)
    assert (info["scenes"], info["num_frames"]) == (3, FRAMES)
    assert set(info["layers"]) == {"sim", "topology", "mesh", "depth.realsense", "depth.none"}
    stats = json.loads(command("stats", *where, cwd=tiny_dataset).stdout)["families"]["custom"]
    assert stats["scenes"] == 3
    assert sum(stats["final"].values()) == 3


def test_the_same_command_again_changes_nothing(
    tiny_dataset: Path, tiny_scenes: Path, tmp_path: Path
) -> None:
    """Resuming a finished dataset makes nothing and leaves every committed byte alone."""
    copy = shutil.copytree(tiny_dataset, tmp_path / "dough")
    before = {p: p.stat().st_mtime_ns for p in (copy / "data").rglob("*") if p.is_file()}
    done = command(
        "generate",
        "--scenes",
        tiny_scenes,
        "--frames",
        FRAMES,
        "--json",
        "--dataset",
        copy,
        cwd=tmp_path,
    )
    assert json.loads(done.stdout)["made"] == {"sim": 0, "topology": 0, "mesh": 0}
    assert before == {p: p.stat().st_mtime_ns for p in (copy / "data").rglob("*") if p.is_file()}


def test_a_changed_configuration_is_refused_by_name(
    tiny_dataset: Path, tiny_scenes: Path, tmp_path: Path
) -> None:
    """Another resolution or number of key frames does not mix with what is there."""
    base = ("generate", "--scenes", tiny_scenes, "--dataset", tiny_dataset)
    done = command(*base, "--frames", 9, cwd=tmp_path, code=1)
    assert "num_frames = 8, not 9" in done.stderr
    done = command(*base, "--frames", FRAMES, "--preset", "fine", cwd=tmp_path, code=1)
    assert "spacing" in done.stderr


def test_depth_before_meshes_names_the_command(tiny_scenes: Path, tmp_path: Path) -> None:
    """Rendering a dataset without meshes says which command makes them."""
    options = ("--frames", FRAMES, "--stages", "simulate", "--executor", "serial")
    command("generate", "--scenes", tiny_scenes, *options, cwd=tmp_path)
    done = command("render", "--noise", "none", cwd=tmp_path, code=1)
    assert "doughdata generate --stages topology,mesh" in done.stderr
