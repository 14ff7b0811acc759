"""The specification's examples work as printed, and its tables list what is on disk."""

import re
from importlib.resources import files

import duckdb
import numpy as np
import pytest

from doughdata.dataset.arrays import ShardedArray
from doughdata.dataset.tables import TABLES
from tests.closed_form import cut_ring
from tests.dataset_helpers import new_writer, write_examples

SPEC = (files("doughschemas") / "SPEC.md").read_text()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_examples(new_writer(tmp_path / "dough-dataset"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "dough-dataset"


def test_python_example_reads_the_particles(folder):
    """The printed lines, with zarr and pyarrow alone, give a key frame's particles."""
    (code,) = re.findall(r"```python\n(.*?)```", SPEC, re.DOTALL)
    assert "doughdata" not in code
    names: dict = {}
    exec(code, names)
    assert np.array_equal(names["points"], cut_ring().particles.positions[2])


def test_duckdb_example_lists_the_merge(folder, monkeypatch):
    """The printed query finds the one merge of the examples."""
    (query,) = re.findall(r"```sql\n(.*?)```", SPEC, re.DOTALL)
    monkeypatch.chdir(folder)
    assert duckdb.sql(query).fetchall() == [(1, 1.92, 1, [0])]


def test_every_array_and_column_is_specified(folder):
    """Each array stands in the specification with its dtype, each table with its columns."""
    kinds = {"f": "f", "u": "u", "i": "i"}
    for meta in folder.glob("data/*/*/arrays.zarr/*/zarr.json"):
        array = ShardedArray(meta.parent)
        short = f"{kinds[array.dtype.kind]}{array.dtype.itemsize * 8}"
        rows = [row for row in SPEC.splitlines() if f"`{meta.parent.name}`" in row and "|" in row]
        assert any(f"| {short} (" in row for row in rows), (meta.parent.name, short)
    tables = SPEC[SPEC.index("## 7. ") :].splitlines()
    for name, columns in TABLES.items():
        (row,) = [row for row in tables if row.startswith(f"| `{name}` |")]
        known = set(re.findall(r"\w+", row)) | {"scene_index", "frame_index", "index", "timestamp"}
        assert {column for column, _ in columns} <= known, name
