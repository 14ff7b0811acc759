"""Statistics are what numpy and DuckDB count in the data themselves."""

import json
from pathlib import Path

import duckdb
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from doughdata.dataset import open_dataset, validate
from doughdata.dataset.measure import dataset_statistics, measure_arrays
from doughdata.dataset.statistics import Moments
from doughdata.dataset.store import LocalStore
from doughdata.dataset.tables import refresh_tables
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import STAGES, new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
BATCH = hnp.arrays(np.float64, st.tuples(st.integers(0, 9), st.just(2)), elements=st.floats(-9, 9))


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Both examples with all layers."""
    write_examples(new_writer(tmp_path / "d"))
    return tmp_path / "d"


@given(st.lists(BATCH, min_size=1, max_size=6))
def test_batches_add_up_to_the_whole(batches: list[np.ndarray]) -> None:
    """However values are cut into batches, count, range, mean and spread are those of all."""
    moments, values = Moments(), np.concatenate(batches)
    for batch in batches:
        moments.add(batch)
    if not len(values):
        assert moments.count == 0
        return
    found = moments.to_json()
    assert found["count"] == [len(values)]
    assert found["min"] == values.min(axis=0).tolist()
    assert found["max"] == values.max(axis=0).tolist()
    np.testing.assert_allclose(found["mean"], values.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(found["std"], values.std(axis=0), atol=1e-12)


def test_table_features_are_what_duckdb_counts(dataset: Path) -> None:
    """Ranges in meta/stats.json equal those that DuckDB finds in the Parquet files."""
    stored = json.loads((dataset / "meta/stats.json").read_text())
    for table, column in (("frames", "opening"), ("frames", "num_components"), ("views", "fx")):
        row = duckdb.sql(
            f"select min(c), max(c), avg(c), stddev_pop(c), count(c) from "
            f"(select {column} as c from '{dataset}/meta/{table}.parquet')"
        ).fetchall()[0]
        found = stored[f"{table}/{column}"]
        given = [found[name][0] for name in ("min", "max", "mean", "std", "count")]
        assert given == pytest.approx(list(row), abs=1e-12)
    genus = duckdb.sql(
        f"select avg(g), count(g) from (select unnest(genus) as g "
        f"from '{dataset}/meta/frames.parquet')"
    ).fetchall()[0]
    found = stored["frames/genus"]
    assert (found["mean"][0], found["count"][0]) == pytest.approx(genus)
    assert len(stored["tool_poses/position"]["mean"]) == 3


def test_arrays_are_measured_when_asked(dataset: Path) -> None:
    """Particles and valid depth have the ranges of the records that were written; they are kept
    while the content stays, and forgotten when it changes."""
    assert "sim/positions" not in dataset_statistics(dataset)["features"]
    refresh_tables(LocalStore(dataset), arrays=measure_arrays(dataset))
    features = dataset_statistics(dataset)["features"]
    points = np.concatenate([e.particles.positions.reshape(-1, 3) for e in (RING, BARS)])
    points = points.astype(float)
    depth = np.concatenate([e.depth.depth.ravel() for e in (RING, BARS)]).astype(float)
    depth = depth[depth > 0] * 1e-4
    np.testing.assert_allclose(features["sim/positions"]["mean"], points.mean(0), atol=1e-12)
    np.testing.assert_allclose(features["depth.none/depth"]["std"], [depth.std()], rtol=1e-9)
    assert features["depth.none/depth"]["count"] == [len(depth)]
    refresh_tables(LocalStore(dataset))
    assert "sim/positions" in dataset_statistics(dataset)["features"]
    assert validate(dataset).problems == ()
    writer = new_writer(dataset)
    writer.plan_family("rolls", split="test", seed=0, count=1)
    for task in writer.tasks("sim"):
        writer.write(task, {task.scenes[0]: RING.particles}, stage=STAGES["sim"])
    writer.refresh()
    assert "sim/positions" not in dataset_statistics(dataset)["features"]


def test_families_end_as_their_last_frames(dataset: Path) -> None:
    """Final topologies, events and the frames where the static check differs are those of the
    closed-form scenes, counted by hand from their records."""
    found = dataset_statistics(dataset)
    assert found["sizes"]["scenes_by_family_and_split"] == {"custom/train": 2}
    assert found["sizes"]["views"] == {"depth.none": 6}
    custom = found["families"]["custom"]
    assert custom["final"] == {"c=2 g=0,0": 1, "c=1 g=0": 1}
    assert custom["final_share"] == {"c=2 g=0,0": 0.5, "c=1 g=0": 0.5}
    assert custom["events"] == {"self_split": 1, "split": 1, "merge": 1}
    differing = sum(
        (int(t.static_num_components[k]), tuple(sorted(t.static_genus[k])))
        != (t.frames[k].num_components, tuple(sorted(t.frames[k].genus)))
        for t in (RING.topology, BARS.topology)
        for k in range(3)
    )
    assert custom["static_differs"] == differing / 6


def test_an_empty_dataset_has_no_ranges(tmp_path: Path) -> None:
    """A dataset without scenes has statistics, a card and Croissant, too, and is valid."""
    new_writer(tmp_path / "d").refresh()
    assert dataset_statistics(tmp_path / "d")["features"] == {}
    assert validate(tmp_path / "d", deep=True).problems == ()
    assert len(open_dataset(tmp_path / "d")) == 0
