"""`gc` removes what no reader can reach and is old enough, and never anything else."""

import os
import subprocess
import sys
import textwrap
import time
from hashlib import sha256
from pathlib import Path
from uuid import uuid4

import pytest

from doughdata.dataset import DatasetWriter, open_dataset, open_writer, validate
from doughdata.dataset.collect import collect
from doughdata.dataset.store import store_of
from doughschemas import DamagedDatasetError, DatasetError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import STAGES, new_writer, write_examples

EXAMPLES = [cut_ring(), joined_bars()]
HOUR = 3600.0


def tree(writer: DatasetWriter) -> dict[str, str]:
    """Every file of a dataset and its sha256."""
    store = writer.store
    return {name: sha256(store.read(name)).hexdigest() for name in store.walk("")}


def with_leftovers(uri: str | Path) -> DatasetWriter:
    """A dataset with a superseded revision in every layer, and an orphan."""
    writer = write_examples(new_writer(uri, scenes_per_shard=2), failed={"sim": {0: "exploded"}})
    (task,) = writer.tasks("sim", retry_failed=True)
    writer.write(task, {i: e.particles for i, e in enumerate(EXAMPLES)}, stage=STAGES["sim"])
    write_examples(writer)
    writer.store.write_folder("data/sim/00000-0000deadbeef", {"arrays.zarr/zarr.json": b"{}"})
    return writer


@pytest.mark.parametrize("place", ["folder", "memory"])
def test_leftovers_go_and_the_dataset_stays(tmp_path: Path, place: str) -> None:
    """With no grace every orphan and superseded attempt goes; what is committed is untouched."""
    uri = tmp_path / "d" if place == "folder" else f"memory://{uuid4().hex}"
    writer = with_leftovers(uri)
    fingerprint, before = writer.info["fingerprint"], tree(writer)
    told = collect(uri, grace=0.0, dry_run=True)
    assert tree(writer) == before, "a dry run removes nothing"
    assert told == collect(uri, grace=0.0)
    assert told.orphans == ("data/sim/00000-0000deadbeef",)
    assert sorted(path.split("/")[1] for path in told.superseded) == [
        *("depth.none", "mesh", "sim", "topology"),
    ]
    after = tree(writer)
    gone = set(before) - set(after)
    assert {k: before[k] for k in after} == after
    assert all(name.startswith((*told.orphans, *told.superseded)) for name in gone)
    assert validate(uri, deep=True).problems == ()
    assert validate(uri).figures["orphans"] == 0
    writer.refresh()
    assert writer.info["fingerprint"] == fingerprint
    assert collect(uri, grace=0.0).orphans == ()


def test_what_is_young_is_kept(tmp_path: Path) -> None:
    """Within the grace period a writer may be at work on an attempt and a reader have one open."""
    writer = with_leftovers(tmp_path / "d")
    half = tmp_path / "d/meta/.tmp-half"
    half.write_text("{")
    before = tree(writer)
    kept = collect(tmp_path / "d", grace=HOUR)
    assert (kept.orphans, kept.superseded, kept.temporary, kept.young) == ((), (), (), 6)
    assert tree(writer) == before
    long_ago = time.time() - 2 * HOUR
    orphan = tmp_path / "d/data/sim/00000-0000deadbeef"
    for path in (half, orphan, *orphan.rglob("*")):
        os.utime(path, (long_ago, long_ago))
    some = collect(tmp_path / "d", grace=HOUR)
    assert some.orphans == ("data/sim/00000-0000deadbeef",)
    assert some.temporary == ("meta/.tmp-half",)
    assert (some.superseded, some.young) == ((), 4)


def test_an_attempt_in_the_making_is_young_by_its_newest_file(tmp_path: Path) -> None:
    """One file of an attempt that was written just now keeps all of it."""
    with_leftovers(tmp_path / "d")
    orphan = tmp_path / "d/data/sim/00000-0000deadbeef"
    long_ago = time.time() - 2 * HOUR
    for path in (orphan, *orphan.rglob("*")):
        os.utime(path, (long_ago, long_ago))
    (orphan / "late.parquet").write_bytes(b"still writing")
    assert collect(tmp_path / "d", grace=HOUR).orphans == ()


def test_a_damaged_record_stops_the_collection(tmp_path: Path) -> None:
    """If it cannot be known what is committed, nothing is removed."""
    writer = with_leftovers(tmp_path / "d")
    record = tmp_path / "d/meta/commits/mesh/00000.1.json"
    record.write_bytes(record.read_bytes().replace(b"mesh", b"mush"))
    before = tree(writer)
    with pytest.raises(DamagedDatasetError, match=r"00000\.1\.json"):
        collect(tmp_path / "d", grace=0.0)
    assert tree(writer) == before
    with pytest.raises(DatasetError, match="is not a dataset"):
        collect(tmp_path)


def test_a_removal_that_was_interrupted_is_finished_later(tmp_path: Path) -> None:
    """A superseded attempt of which only a part is left is no damage, and the next run takes it."""
    writer = with_leftovers(tmp_path / "d")
    old = collect(tmp_path / "d", grace=0.0, dry_run=True).superseded[0]
    store = store_of(tmp_path / "d")
    for name in store.walk(old)[::2]:
        store.local(f"{old}/{name}").unlink()
    assert validate(writer.uri, deep=True).problems == ()
    assert old in collect(tmp_path / "d", grace=0.0).superseded


def test_reading_writes_nothing(tmp_path: Path) -> None:
    """Opening, reading and validating never open a file of the dataset for writing."""
    write_examples(new_writer(tmp_path / "d"))
    code = """
        import os, sys
        root, writing = sys.argv[1], os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
        def watch(event, args):
            changes = event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link")
            writes = event == "open" and args[2] & writing
            if (changes or writes) and str(args[0]).startswith(root):
                os.write(2, f"{event} {args}\\n".encode())
                os._exit(3)
        sys.addaudithook(watch)
        from doughdata import open_dataset
        from doughdata.dataset import validate
        dataset = open_dataset(root)
        frame = dataset.frame(scene=0, frame=1)
        assert len(frame.meshes) == frame.topology.num_components
        assert validate(root, deep=True).ok
    """
    command = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "d")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_no_place_to_write_is_one_line(tmp_path: Path) -> None:
    """Where the system refuses to make a file, the line names the dataset and the reason."""
    writer = write_examples(new_writer(tmp_path / "d"), layers=["sim"])
    (tmp_path / "d/data/topology").write_text("in the way")
    task = writer.tasks("topology")[0]
    with pytest.raises(DatasetError, match="a file stands where a folder is needed") as error:
        open_writer(writer.uri).write(task, {0: EXAMPLES[0].topology}, stage=STAGES["topology"])
    assert "\n" not in str(error.value)
    assert open_dataset(writer.uri).layers == ["sim"]
