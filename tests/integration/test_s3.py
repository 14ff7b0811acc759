"""A dataset in an object store: the same promises as on a disk, against a real S3 server."""

import json
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest

from doughdata.dataset import open_dataset, open_writer, validate
from doughdata.dataset.remote import RemoteStore
from doughdata.dataset.store import LocalStore, Store
from doughschemas import DamagedDatasetError, DatasetError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import STAGES, equal, new_writer, write_examples
from tests.integration.conftest import TINY, command
from tests.object_store import BUCKET, CutLine, environment, object_store, set_environment

EXAMPLES = [cut_ring(), joined_bars()]


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with object_store() as endpoint, set_environment(**environment(endpoint)):
        yield endpoint


@pytest.fixture
def uri(endpoint: str) -> str:
    """A place of its own for every test."""
    return f"s3://{BUCKET}/{uuid4().hex}/dough"


@pytest.fixture(scope="module")
def stored(endpoint: str) -> str:
    uri = f"s3://{BUCKET}/stored"
    write_examples(new_writer(uri))
    return uri


@pytest.fixture(params=["local", "memory", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    if request.param == "local":
        return LocalStore(tmp_path / "d")
    if request.param == "memory":
        return RemoteStore(f"memory://{uuid4().hex}")
    return RemoteStore(request.getfixturevalue("uri"))


def test_every_store_keeps_the_same_promises(store: Store) -> None:
    """Create never replaces, replace does, folders appear whole, ranges and names are exact."""
    assert not store.exists("")
    assert store.names("a") == store.walk("a") == []
    assert store.create("a/one.json", b"first") is True
    assert store.create("a/one.json", b"second") is False
    assert store.read("a/one.json") == b"first"
    store.replace("a/one.json", b"0123456789")
    parts = [store.read_range("a/one.json", *at) for at in ((2, 5), (7,), (-3,), (-99,), (8, 99))]
    assert parts == [b"234", b"789", b"789", b"0123456789", b"89"]
    store.write_folder("a/deep", {"x": b"x", "y/z": b"z"})
    assert store.names("a") == ["deep", "one.json"]
    assert store.walk("a") == ["deep/x", "deep/y/z", "one.json"]
    assert (store.is_file("a"), store.is_file("a/deep/x"), store.exists("a/deep")) == (0, 1, 1)
    assert store.modified("a/deep") > 1.7e9 > store.modified("nothing")
    assert store.fetch("a/deep/x").read_bytes() == b"x"
    store.remove("a/deep")
    store.remove("a/never")
    assert store.walk("a") == ["one.json"]
    for read in (store.read, lambda path: store.read_range(path, -4)):
        with pytest.raises(DamagedDatasetError, match="a/gone is missing"):
            read("a/gone")


def test_what_is_written_to_s3_comes_back(stored: str, tmp_path: Path) -> None:
    """Every record bit for bit; same fingerprint as on a disk; deep validation is silent."""
    dataset = open_dataset(stored)
    for index, example in enumerate(EXAMPLES):
        assert equal(dataset.read_particles(index), example.particles)
        assert equal(dataset.read_topology(index), example.topology)
        assert equal(dataset.read_depth(index, "none"), example.depth)
        assert equal(dataset.read_meshes(index, 1), example.meshes[1])
    assert dataset.fingerprint == write_examples(new_writer(tmp_path / "d")).info["fingerprint"]
    report = validate(stored, deep=True)
    assert report.problems == ()
    assert report.figures["orphans"] == 0


def test_an_array_written_otherwise_is_read_through_zarr(endpoint: str, uri: str) -> None:
    """A legal Zarr array of another layout, in the bucket, is read by the fallback."""
    import zarr

    from doughdata.dataset.arrays import ShardedArray

    values = np.arange(24, dtype=np.int32).reshape(4, 6)
    zarr.create_array(f"{uri}/plain", data=values, chunks=(2, 3))
    array = ShardedArray("plain", store=RemoteStore(uri))
    assert array.chunk is None
    assert np.array_equal(array.all(), values)
    assert np.array_equal(array.row(2), values[2])


def _positions(dataset, queue) -> None:
    queue.put(float(np.nansum(dataset.frame(scene=1, frame=2).particles.positions)))


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_dataset_that_was_read_can_be_handed_to_a_child(stored: str, method: str) -> None:
    """After the parent has read over the network, a forked or spawned child reads the same."""
    dataset = open_dataset(stored)
    here = float(np.nansum(dataset.frame(scene=1, frame=2).particles.positions))
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    child = context.Process(target=_positions, args=(dataset, queue))
    child.start()
    try:
        assert queue.get(timeout=60) == here
    finally:
        child.kill()
        child.join()


def test_a_line_that_breaks_once_is_used_again(endpoint: str, uri: str) -> None:
    """Every third request is dropped before it arrives: writing and reading go on regardless."""
    count = iter(range(10**6))
    with (
        CutLine(endpoint, lambda _: next(count) % 3 == 2) as line,
        set_environment(AWS_ENDPOINT_URL=line.endpoint),
    ):
        write_examples(new_writer(uri), EXAMPLES[:1])
    assert validate(uri, deep=True).problems == ()


def test_a_lost_answer_does_not_cost_the_attempt(endpoint: str, uri: str) -> None:
    """A commit whose answer was lost is asked again and refused: it is still this writer's own."""
    lost: set[bytes] = set()

    def first_time(request: bytes) -> bool:
        name = request.split(b" ")[1]
        doomed = request.startswith(b"PUT") and b"/meta/commits/" in name and name not in lost
        lost.add(name)
        return doomed

    with (
        CutLine(endpoint, first_time, after=True) as line,
        set_environment(AWS_ENDPOINT_URL=line.endpoint),
    ):
        write_examples(new_writer(uri), EXAMPLES[:1])
    assert any(b"/meta/commits/sim/" in name for name in lost)
    assert validate(uri, deep=True).problems == ()
    assert validate(uri).figures["orphans"] == 0


def test_a_line_that_breaks_for_good_leaves_nothing_that_counts(endpoint: str, uri: str) -> None:
    """Cut in the middle of an upload: one line, no commit; the same call later completes."""
    writer = write_examples(new_writer(uri), layers=["sim"])
    (task, other) = writer.tasks("topology")
    topologies = {i: e.topology for i, e in enumerate(EXAMPLES)}
    broken = iter(range(10**6))
    with (
        CutLine(endpoint, lambda r: r.startswith(b"PUT") and next(broken) >= 3) as line,
        set_environment(AWS_ENDPOINT_URL=line.endpoint),
        pytest.raises(DatasetError, match="the connection failed") as error,
    ):
        open_writer(uri).write(task, {0: topologies[0]}, stage=STAGES["topology"])
    assert "\n" not in str(error.value)
    assert RemoteStore(uri).names("meta/commits") == ["sim"]
    for again in (task, other):
        (scene,) = again.scenes
        writer.write(again, {scene: topologies[scene]}, stage=STAGES["topology"])
    writer.refresh()
    assert validate(uri, deep=True).problems == ()


def test_two_writers_in_the_bucket_commit_a_shard_once(uri: str) -> None:
    """Who loses the race gets the winner's commit and removes its own attempt."""
    writer = new_writer(uri)
    writer.plan_scenes([EXAMPLES[0].scene])
    (task,) = writer.tasks("sim")
    one = writer.write(task, {0: EXAMPLES[0].particles}, stage=STAGES["sim"])
    two = open_writer(uri).write(task, {0: EXAMPLES[0].particles}, stage=STAGES["sim"])
    assert one == two
    assert len(writer.store.names("data/sim")) == 1


@pytest.mark.parametrize(
    ("variables", "place", "message"),
    [
        ({}, "s3://no-such-bucket-here/dough", "no such bucket"),
        ({"AWS_ENDPOINT_URL": "http://127.0.0.1:9"}, f"s3://{BUCKET}/x", "the connection failed"),
        (
            dict.fromkeys(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"), "")
            | {"AWS_SHARED_CREDENTIALS_FILE": "/dev/null", "AWS_CONFIG_FILE": "/dev/null"},
            f"s3://{BUCKET}/x",
            "AWS_ACCESS_KEY_ID",
        ),
        ({}, f"s3://{BUCKET}/nothing-here", "no such dataset"),
        ({}, "s3://", "name a bucket"),
    ],
)
def test_what_is_wrong_with_a_bucket_is_said_in_one_line(
    endpoint: str, variables: dict[str, str], place: str, message: str
) -> None:
    """No bucket, no server, no credentials, no dataset: each has its own line."""
    with set_environment(**variables), pytest.raises(DatasetError, match=message) as error:
        open_dataset(place)
    assert "\n" not in str(error.value)
    if message != "no such dataset":
        with set_environment(**variables), pytest.raises(DatasetError, match=message):
            new_writer(place)


def test_the_commands_work_on_a_bucket(uri: str, tmp_path: Path) -> None:
    """Generate, render, validate, info, stats, view, gc: each takes a URI as it takes a folder."""
    (tmp_path / "one.json").write_text(json.dumps([TINY[1]]))
    where = ("--dataset", uri)
    again = ("generate", "--scenes", "one.json", "--frames", 4, *where, "--json")
    first = json.loads(command(*again, cwd=tmp_path).stdout)
    assert first["made"] == {"sim": 1, "topology": 1, "mesh": 1}
    assert json.loads(command(*again, cwd=tmp_path).stdout)["kept"] == first["made"]
    command("render", "--noise", "none", "--all-frames", *where, cwd=tmp_path)
    command("validate", "--deep", *where, cwd=tmp_path)
    info = json.loads(command("info", "--json", *where, cwd=tmp_path).stdout)
    assert info["layers"] == ["sim", "topology", "mesh", "depth.none"]
    assert info["fingerprint"] == open_dataset(uri).fingerprint
    command("stats", "--json", *where, cwd=tmp_path)
    command("view", "--scene", 0, "--save", "sheet.png", *where, cwd=tmp_path)
    assert (tmp_path / "sheet.png").stat().st_size > 10_000
    removed = json.loads(command("gc", "--grace", 0, "--json", *where, cwd=tmp_path).stdout)
    assert (removed["orphans"], removed["superseded"]) == ([], [])
    gone = command("info", "--dataset", "s3://no-such-bucket-here/d", cwd=tmp_path, code=1)
    assert "no such bucket" in gone.stderr.splitlines()[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "sheet.png"]


def test_samples_for_training_come_from_a_bucket(stored: str) -> None:
    """DoughDataset over the network gives what it gives from a folder, with worker processes."""
    from multiprocessing import forkserver

    import torch
    from torch.utils.data import DataLoader

    from doughdata.torch import DoughDataset

    dataset = DoughDataset(stored, sensor="none", num_points=32, num_queries=64)
    here = [dataset[k] for k in range(len(dataset))]
    forkserver._forkserver._stop()  # one that an earlier test started knows no credentials
    for context in ("fork", "spawn", "forkserver"):
        loader = DataLoader(
            dataset, batch_size=None, num_workers=1, multiprocessing_context=context
        )
        for own, theirs in zip(here, loader, strict=True):
            assert all(torch.equal(own[name], theirs[name]) for name in own), context
