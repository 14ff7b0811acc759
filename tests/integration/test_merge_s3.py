"""Copies between disks and object stores, against a real S3 server."""

from pathlib import Path

import pytest

from doughdata.dataset import open_dataset, validate
from doughdata.dataset.measure import measure_arrays
from doughdata.dataset.merge import merge
from doughdata.dataset.selection import SceneFilter
from doughdata.dataset.store import store_of
from doughdata.dataset.subset import subset
from doughdata.dataset.tables import refresh_tables
from doughdata.exporters.hf import HuggingFace
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import equal, new_writer, write_examples
from tests.object_store import BUCKET, environment, object_store, set_environment


@pytest.mark.slow
def test_from_disk_to_s3_and_back(tmp_path: Path) -> None:
    """Datasets on a disk and in a bucket merge into a bucket, a subset of that comes back to the
    disk, and every record, card and statistic is what it would be on a disk."""
    ring, bars = cut_ring(), joined_bars()
    with object_store() as endpoint, set_environment(**environment(endpoint)):
        there, into = f"s3://{BUCKET}/bars", f"s3://{BUCKET}/both"
        write_examples(new_writer(tmp_path / "ring"), [ring])
        write_examples(new_writer(there), [bars])
        assert merge([tmp_path / "ring", there], into).scenes == 2
        assert merge([tmp_path / "ring", there], into).kept == 8
        assert validate(into, deep=True).problems == ()
        refresh_tables(store_of(into), arrays=measure_arrays(into))
        subset(into, tmp_path / "back", SceneFilter(scenes=(1,)))
        HuggingFace().export(open_dataset(into), [0, 1], tmp_path / "hf")
        names = store_of(into).names("")
    assert {"README.md", "croissant.json"} <= set(names)
    assert (tmp_path / "hf/README.md").is_file()
    back = open_dataset(tmp_path / "back")
    assert equal(back.read_particles(0), bars.particles)
    assert equal(back.read_topology(0), bars.topology)
    assert validate(tmp_path / "back", deep=True).problems == ()
