"""Planning, resuming, extending, committing: what must survive crashes, races and full disks."""

import multiprocessing
import resource
import subprocess
import sys
import textwrap
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest

from doughdata.dataset import (
    DatasetSettings,
    StageRecord,
    default_scenes_per_shard,
    open_dataset,
    open_writer,
    validate,
)
from doughschemas import BadInputError, DatasetError, MissingLayerError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import STAGES, equal, new_writer, write_examples

EXAMPLES = [cut_ring(), joined_bars()]
RING = EXAMPLES[0]


def tree(root) -> dict[str, str]:
    """Every file below a folder and its sha256."""
    files = (p for p in Path(root).rglob("*") if p.is_file())
    return {str(p.relative_to(root)): sha256(p.read_bytes()).hexdigest() for p in files}


def write_sim(writer, *, failed=()):
    """Write whatever `sim` shards are missing, with the ring as every scene's result."""
    tasks = writer.tasks("sim")
    for task in tasks:
        done = {i: RING.particles for i in task.scenes if i not in failed}
        bad = {i: "exploded" for i in task.scenes if i in failed}
        writer.write(task, done, stage=STAGES["sim"], failed=bad)
    return tasks


def test_same_command_resumes_and_larger_n_extends(tmp_path):
    """Planning twice plans once; a larger N adds shards and leaves finished ones untouched."""
    writer = new_writer(tmp_path / "d", scenes_per_shard=2)
    first = writer.plan_family("rolls", split="train", seed=0, count=3)
    assert [s.scene_indices for s in first] == [(0, 1), (2,)]
    write_sim(writer)
    before = tree(tmp_path / "d/data")
    assert writer.plan_family("rolls", split="train", seed=0, count=2) == first
    other = writer.plan_family("doughnut", split="test", seed=7, count=1)
    grown = writer.plan_family("rolls", split="train", seed=0, count=6)
    assert [s.scene_indices for s in other] == [(3,)]
    assert [s.scene_indices for s in grown] == [(0, 1), (2,), (4, 5), (6,)]
    assert [task.shard for task in write_sim(writer)] == ["00002", "00003", "00004"]
    assert write_sim(writer) == []
    assert before.items() <= tree(tmp_path / "d/data").items()
    scenes = {i: s for t in grown for i, s in writer.scenes(_task_of(writer, t)).items()}
    ids = [scenes[i].scene_id for i in (0, 1, 2, 4, 5, 6)]
    assert ids == [f"rolls-train-s0-{k:06d}" for k in range(6)]


def _task_of(writer, shard):
    from doughdata.dataset import Task

    scenes = shard.scene_indices
    return Task(layer="sim", shard=shard.id, scenes=scenes, revision=0, upstream={})


def test_user_scenes_are_planned_once_and_clashes_refused(tmp_path):
    """A scene file may be given again; another scene under the same name is refused by name."""
    writer = new_writer(tmp_path / "d")
    shards = writer.plan_scenes([RING.scene])
    assert writer.plan_scenes([RING.scene]) == shards
    both = writer.plan_scenes([e.scene for e in EXAMPLES])
    assert [s.scene_indices for s in both] == [(0,), (1,)]
    changed = replace(RING.scene, table_friction=0.1)
    with pytest.raises(DatasetError, match=r"another scene 'closed-form-cut-ring'"):
        writer.plan_scenes([changed])
    writer.plan_family("rolls", split="train", seed=0, count=1)
    sampled = writer.scenes(_task_of(writer, writer.shards()[-1]))[2]
    with pytest.raises(DatasetError, match="rolls-train-s0-000000"):
        writer.plan_scenes([sampled])


def test_tool_mesh_travels_with_the_dataset(tmp_path):
    """A tool mesh is copied into the dataset, and scenes read back name a file that exists."""
    import trimesh

    box = trimesh.creation.box(extents=[10, 20, 40])
    box.apply_translation([5, 0, 20])
    box.export(tmp_path / "tool.stl")
    tool = replace(RING.scene.tools[0], mesh=str(tmp_path / "tool.stl"), scale=0.001)
    example = replace(RING, scene=replace(RING.scene, tools=(tool,)))
    write_examples(new_writer(tmp_path / "d"), [example], layers=["sim"])
    (tmp_path / "tool.stl").unlink()
    (tmp_path / "d").rename(tmp_path / "moved")
    read = open_dataset(str(tmp_path / "moved")).scene(0).tools[0]
    mesh = trimesh.load(read.mesh, force="mesh")
    assert mesh.is_watertight
    assert mesh.volume * read.scale**3 == pytest.approx(0.01 * 0.02 * 0.04, rel=1e-5)


def test_failed_scenes_keep_their_reason_and_can_be_retried(tmp_path):
    """A failed scene costs nothing but itself; a retry makes later layers stale, then fresh."""
    writer = new_writer(tmp_path / "d", scenes_per_shard=2)
    write_examples(writer, failed={"sim": {0: "it exploded"}})
    assert writer.info["total_scenes"] == 1
    dataset = open_dataset(writer.uri)
    assert dataset.scene_indices == [1]
    with pytest.raises(MissingLayerError, match=r"it exploded.*--retry-failed"):
        dataset.read_particles(0)
    assert equal(dataset.read_topology(1), EXAMPLES[1].topology)
    assert writer.tasks("sim") == []
    (task,) = writer.tasks("sim", retry_failed=True)
    assert (task.revision, task.scenes) == (1, (0, 1))
    records = {i: e.particles for i, e in enumerate(EXAMPLES)}
    writer.write(task, records, stage=STAGES["sim"])
    with pytest.raises(MissingLayerError, match="topology"):
        open_dataset(writer.uri).read_topology(1)
    assert writer.tasks("mesh") == [], "mesh must wait for the stale topology"
    write_examples(writer)
    dataset = open_dataset(writer.uri)
    for index, example in enumerate(EXAMPLES):
        assert equal(dataset.read_topology(index), example.topology)
        assert equal(dataset.read_depth(index, "none"), example.depth)
    assert validate(writer.uri, deep=True).problems == ()


def test_failure_in_a_later_layer_leaves_nulls(tmp_path):
    """A scene without topology keeps its frames, with nulls and the reason in the tables."""
    writer = new_writer(tmp_path / "d", scenes_per_shard=2)
    write_examples(writer, failed={"topology": {0: "no bonds"}})
    dataset = open_dataset(writer.uri)
    components = dataset.frames["num_components"].to_pylist()
    assert components == [None] * NUM_FRAMES + [2, 2, 1]
    assert dataset.scenes["failed"].to_pylist() == ["topology: no bonds", None]
    with pytest.raises(MissingLayerError, match="no bonds"):
        dataset.read_topology(0)
    assert equal(dataset.read_meshes(1, 2), EXAMPLES[1].meshes[2])
    assert validate(writer.uri, deep=True).problems == ()


def test_a_shard_in_which_all_failed_is_committed_without_data(tmp_path):
    """Nothing is written for a shard without results, and it is not tried again by itself."""
    writer = new_writer(tmp_path / "d")
    writer.plan_family("rolls", split="train", seed=0, count=1)
    write_sim(writer, failed=(0,))
    assert not (tmp_path / "d/data").exists()
    assert writer.tasks("sim") == writer.tasks("topology") == []
    writer.refresh()
    assert (len(open_dataset(writer.uri)), writer.info["total_failed"]) == (0, 1)
    assert validate(writer.uri, deep=True).problems == ()


def test_changed_configuration_is_refused_by_name(tmp_path):
    """Another number of frames, shard size, stage or option is named; a new version is not."""
    new_writer(tmp_path / "d")
    uri = str(tmp_path / "d")
    other = {"sim": StageRecord(name="cubes", config={"spacing": 0.0015})}
    with pytest.raises(DatasetError, match=r"sim\.spacing = 0\.002, not 0\.0015"):
        open_writer(uri, DatasetSettings(stages=other))
    with pytest.raises(DatasetError, match=r"num_frames = 3, not 75"):
        open_writer(uri, DatasetSettings(num_frames=75))
    with pytest.raises(DatasetError, match=r"scenes_per_shard = 1, not 4"):
        open_writer(uri, DatasetSettings(scenes_per_shard=4))
    newer = {"sim": replace(STAGES["sim"], version="2")}
    assert open_writer(uri, DatasetSettings(stages=newer)).num_frames == NUM_FRAMES


def test_a_layer_named_later_is_checked_against_its_commits(tmp_path):
    """A depth layer is no part of the settings, but its configuration may not change either."""
    stages = {k: v for k, v in STAGES.items() if k != "depth.none"}
    writer = write_examples(new_writer(tmp_path / "d", stages=stages), [RING])
    writer.check_stage("depth.none", STAGES["depth.none"])
    changed = StageRecord(name="none", config={"views": 2})
    with pytest.raises(DatasetError, match=r"depth\.none\.views = 1, not 2"):
        writer.check_stage("depth.none", changed)
    assert writer.tasks("depth.none") == []
    assert [t.revision for t in writer.tasks("depth.none", replace_with=changed)] == [1]


@pytest.mark.parametrize("name", ["notes.txt", "data/x", "meta/other.json"])
def test_foreign_folders_are_refused_and_left_alone(tmp_path, name):
    """A folder that holds something else is named and not touched; so is a file."""
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    before = tree(tmp_path)
    with pytest.raises(DatasetError, match="holds something else") as error:
        new_writer(tmp_path)
    assert tree(tmp_path) == before
    assert "\n" not in str(error.value)
    with pytest.raises(DatasetError, match="is a file"):
        new_writer(tmp_path / name)


def test_clear_errors_where_there_is_no_dataset(tmp_path):
    """No folder, no dataset in it, and a URI of no known kind: each says so in one line."""
    with pytest.raises(DatasetError, match="no such dataset"):
        open_dataset(str(tmp_path / "nowhere"))
    with pytest.raises(DatasetError, match="is not a dataset"):
        open_dataset(str(tmp_path))
    with pytest.raises(DatasetError, match=r"ftp:// is not supported.*local folder.*s3://"):
        open_dataset("ftp://host/dataset")


def test_records_must_fit_the_task(tmp_path):
    """A missing scene, a stranger and a wrong number of frames are refused, and nothing is left."""
    writer = new_writer(tmp_path / "d")
    writer.plan_scenes([RING.scene])
    (task,) = writer.tasks("sim")
    short = replace(RING.particles, positions=RING.particles.positions[:2])
    for records in ({}, {0: RING.particles, 1: RING.particles}, {0: short}):
        with pytest.raises(BadInputError):
            writer.write(task, records, stage=STAGES["sim"])
    assert not (tmp_path / "d/data").exists()
    assert writer.tasks("sim") == [task]


def test_two_writers_commit_a_shard_once(tmp_path):
    """Who loses the race gets the winner's commit and removes its own attempt."""
    writer = new_writer(tmp_path / "d")
    writer.plan_scenes([RING.scene])
    (task,) = writer.tasks("sim")
    one = writer.write(task, {0: RING.particles}, stage=STAGES["sim"])
    two = writer.write(task, {0: RING.particles}, stage=STAGES["sim"])
    assert one == two
    assert len(list((tmp_path / "d/data/sim").iterdir())) == 1
    writer.refresh()
    assert validate(writer.uri).ok


def test_full_disk_is_one_line_and_loses_nothing(tmp_path):
    """When the system refuses to write, one line tells it, and finished shards stay valid."""
    writer = new_writer(tmp_path / "d")
    write_examples(writer, [RING], layers=["sim"])
    before = tree(tmp_path / "d")
    code = """
        import resource, sys
        from tests.dataset_helpers import *
        from doughschemas import DatasetError
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, 512))
        writer = open_writer(sys.argv[1])
        (task,) = writer.tasks("topology")
        try:
            writer.write(task, {0: cut_ring().topology}, stage=STAGES["topology"])
        except DatasetError as error:
            print(error)
    """
    command = [sys.executable, "-c", textwrap.dedent(code), writer.uri]
    result = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path.cwd())
    assert "file too large" in result.stdout
    assert len(result.stdout.splitlines()) == 1, result.stdout
    assert tree(tmp_path / "d") == before
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def _write_until_killed(uri, ready):
    writer = open_writer(uri)
    ready.set()
    for task in writer.tasks("sim"):
        records = {i: EXAMPLES[i % 2].particles for i in task.scenes}
        writer.write(task, records, stage=STAGES["sim"])


@pytest.mark.parametrize("delay", [0.01, 0.1])
def test_kill_minus_nine_then_resume(tmp_path, delay):
    """After SIGKILL at any moment the same command finishes; finished shards keep their hashes."""
    writer = new_writer(tmp_path / "d")
    writer.plan_family("rolls", split="train", seed=0, count=12)
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=_write_until_killed, args=(writer.uri, ready))
    process.start()
    assert ready.wait(60)
    process.join(delay)
    process.kill()
    process.join()
    committed = {p.name for p in (tmp_path / "d/meta/commits").rglob("*.json")}
    before = tree(tmp_path / "d")
    write_sim(writer)
    writer.refresh()
    after = tree(tmp_path / "d")
    kept = {k: v for k, v in before.items() if k.startswith("meta/commits")}
    assert kept.items() <= after.items()
    assert len(kept) == len(committed)
    assert writer.info["total_scenes"] == 12
    assert validate(writer.uri, deep=True).problems == ()


def test_a_dataset_can_be_made_where_a_crash_left_an_empty_start(tmp_path):
    """A crash before info.json was published leaves a folder that the next run takes over."""
    (tmp_path / "d/meta").mkdir(parents=True)
    (tmp_path / "d/meta/.tmp-123").write_text("half")
    assert new_writer(tmp_path / "d").num_frames == NUM_FRAMES


def test_layers_have_equal_hashes_whoever_wrote_them(tmp_path):
    """The same records give the same file hashes and the same fingerprint in another dataset."""
    one = write_examples(new_writer(tmp_path / "one"))
    two = write_examples(new_writer(tmp_path / "two"))
    assert open_dataset(one.uri).fingerprint == open_dataset(two.uri).fingerprint != ""
    three = write_examples(new_writer(tmp_path / "three"), [RING])
    assert open_dataset(three.uri).fingerprint != open_dataset(one.uri).fingerprint


def test_shard_size_follows_the_number_of_scenes():
    """1 below 64 scenes, 8 below 1,000, else 32."""
    sizes = [default_scenes_per_shard(n) for n in (1, 63, 64, 999, 1000, 10_000)]
    assert sizes == [1, 1, 8, 8, 32, 32]
