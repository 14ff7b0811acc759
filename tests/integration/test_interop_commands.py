"""merge, subset, split, card and stats as a user types them, on a small real dataset."""

import json
from pathlib import Path

import duckdb
import numpy as np
import pytest
import tensorstore

from doughdata.dataset import open_dataset
from doughdata.dataset.tables import TABLES
from tests.integration.conftest import FRAMES, command


def test_taken_apart_and_put_together_again(tiny_dataset: Path, tmp_path: Path) -> None:
    """Subsets that are merged again hold every record of the whole and pass deep validation."""
    few = ("subset", "--dataset", tiny_dataset, "--scenes")
    command(*few, "0,2", "--into", "a", cwd=tmp_path)
    command(*few, "1", "--into", "b", cwd=tmp_path)
    done = command("merge", "a", "b", "--into", "c", "--json", cwd=tmp_path)
    assert json.loads(done.stdout) == {"dataset": "c", "scenes": 3, "shards": 3, "kept": 0}
    command("validate", "--deep", "--dataset", "c", cwd=tmp_path)
    whole, merged = open_dataset(tiny_dataset), open_dataset(tmp_path / "c")
    for new, old in enumerate((0, 2, 1)):
        assert merged.scene(new) == whole.scene(old)
        for k in (0, FRAMES - 1):
            one, other = (d.frame(scene=i, frame=k) for d, i in ((whole, old), (merged, new)))
            assert np.array_equal(one.particles.positions, other.particles.positions)
            assert np.array_equal(one.topology.labels, other.topology.labels)
            assert np.array_equal(one.label_grid.labels, other.label_grid.labels)
    assert (
        json.loads(command("merge", "a", "b", "--into", "c", "--json", cwd=tmp_path).stdout)["kept"]
        == 15
    )


def test_divided_anew(tiny_dataset: Path, tmp_path: Path) -> None:
    """`split` makes the share that was asked for of scenes that users wrote, and says so when it
    cannot."""
    options = ("split", "--dataset", tiny_dataset, "--into")
    command(*options, "d", "--test", 0.34, cwd=tmp_path)
    splits = open_dataset(tmp_path / "d").scenes["split"].to_pylist()
    assert sorted(splits) == ["test", "train", "train"]
    done = command(*options, "e", "--test", 0.1, cwd=tmp_path, code=1)
    assert "ask for more --test" in done.stderr
    assert not (tmp_path / "e").exists()


def test_described_to_others(tiny_dataset: Path, tmp_path: Path) -> None:
    """A dataset has its card, Croissant and statistics as soon as it is generated; `card` and
    `stats --arrays` write them again, and the dataset stays valid."""
    names = ("README.md", "croissant.json", "meta/stats.json")
    assert all((tiny_dataset / name).is_file() for name in names)
    command("subset", "--dataset", tiny_dataset, "--scenes", 0, "--into", "a", cwd=tmp_path)
    command("card", "--dataset", "a", "--license", "cc-by-4.0", cwd=tmp_path)
    done = command("stats", "--dataset", "a", "--arrays", "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    points = open_dataset(tmp_path / "a").read_particles(0).positions.astype(float)
    measured = found["features"]["sim/positions"]
    np.testing.assert_allclose(measured["mean"], points.mean(axis=(0, 1)), atol=1e-12)
    assert measured["count"] == [points.shape[0] * points.shape[1]]
    assert found["sizes"]["frames"] == FRAMES
    assert "license: cc-by-4.0" in (tmp_path / "a/README.md").read_text()
    command("validate", "--deep", "--dataset", "a", cwd=tmp_path)


BAD = {
    "one source": (("merge", "{tiny}", "--into", "x"), 2, "two datasets"),
    "twice": (("merge", "{tiny}", "{tiny}", "--into", "x"), 1, "--skip-duplicates"),
    "no condition": (("subset", "--dataset", "{tiny}", "--into", "x"), 2, "at least one"),
    "no such end": (
        ("subset", "--dataset", "{tiny}", "--final", "c=77", "--into", "x"),
        2,
        "no final topology",
    ),
    "indices": (("subset", "--dataset", "{tiny}", "--scenes", "0-", "--into", "x"), 2, "0,4-9"),
    "share": (("split", "--dataset", "{tiny}", "--test", "1.5", "--into", "x"), 2, "0..1"),
    "nothing": (("card", "--dataset", "nowhere"), 1, "no such dataset"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_usage_gets_one_clear_line(what: str, tiny_dataset: Path, tmp_path: Path) -> None:
    """A wrong request is told in one line with its exit code, and nothing is made."""
    arguments, code, message = BAD[what]
    filled = (argument.format(tiny=tiny_dataset) for argument in arguments)
    done = command(*filled, cwd=tmp_path, code=code)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_others_read_every_array_and_table(tiny_dataset: Path) -> None:
    """tensorstore gives each array as zarr-python does; DuckDB each table as many rows as we."""
    import zarr

    opened = open_dataset(tiny_dataset)
    arrays = [path.parent for path in tiny_dataset.glob("data/*/*/arrays.zarr/*/zarr.json")]
    layers = {path.relative_to(tiny_dataset).parts[1] for path in arrays}
    assert layers == {"sim", "topology", "mesh", "depth.realsense", "depth.none"}
    for path in arrays:
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path)}}
        theirs = tensorstore.open(spec).result().read().result()
        ours = np.asarray(zarr.open_array(path, mode="r")[...])
        assert (theirs.dtype, theirs.tobytes()) == (ours.dtype, ours.tobytes()), path
    for name in TABLES:
        ((count,),) = duckdb.sql(
            f"select count(*) from '{tiny_dataset}/meta/{name}.parquet'"
        ).fetchall()
        assert count == len(opened.table(name))
    for path in tiny_dataset.glob("data/*/*/*.parquet"):
        assert duckdb.sql(f"select * from '{path}'").fetchall() is not None
