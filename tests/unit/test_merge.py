"""Datasets become one: nothing is lost, nothing is there twice, and the sources stay."""

import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from doughdata.dataset import StageRecord, open_dataset, open_writer, validate
from doughdata.dataset.layers import RecordedScene
from doughdata.dataset.merge import merge
from doughdata.dataset.plan import read_plans
from doughdata.dataset.selection import SceneFilter
from doughdata.dataset.split import SplitPlan, resplit
from doughdata.dataset.spool import RowSpool
from doughdata.dataset.store import LocalStore
from doughdata.dataset.subset import subset
from doughdata.recordings.writing import commit_scene
from doughschemas import Action, BadInputError, DamagedDatasetError, DatasetError
from tests.closed_form import CAMERA, NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import STAGES, equal, new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
CONFORMANCE = Path(__file__).parents[1] / "conformance/v1"


def tree(root: Path) -> dict[str, str]:
    """Every file below a folder and its sha256."""
    files = (p for p in root.rglob("*") if p.is_file())
    return {str(p.relative_to(root)): sha256(p.read_bytes()).hexdigest() for p in files}


def family_dataset(path: Path, *, seed: int, count: int = 2, failed: tuple[int, ...] = ()):
    """Scenes that are planned as of family `rolls`, each with the ring's particles."""
    writer = new_writer(path, scenes_per_shard=2)
    writer.plan_family("rolls", split="train", seed=seed, count=count)
    for task in writer.tasks("sim"):
        done = {i: RING.particles for i in task.scenes if i not in failed}
        bad = {i: "exploded" for i in task.scenes if i in failed}
        writer.write(task, done, stage=STAGES["sim"], failed=bad)
    writer.refresh()
    return writer


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    """Two datasets of one scene each, with all layers."""
    write_examples(new_writer(tmp_path / "a"), [RING])
    write_examples(new_writer(tmp_path / "b"), [BARS])
    return [tmp_path / "a", tmp_path / "b"]


def test_every_record_comes_through(sources: list[Path], tmp_path: Path) -> None:
    """The merged dataset gives bit for bit what was written, passes validation, and its sources
    have not changed."""
    before = [tree(source) for source in sources]
    assert merge(sources, tmp_path / "c").scenes == 2
    assert [tree(source) for source in sources] == before
    assert validate(tmp_path / "c", deep=True).problems == ()
    merged = open_dataset(tmp_path / "c")
    for index, example in enumerate((RING, BARS)):
        assert merged.scene(index) == example.scene
        assert equal(merged.read_particles(index), example.particles)
        assert equal(merged.read_topology(index), example.topology)
        assert equal(merged.read_depth(index, "none"), example.depth)
        for k in range(NUM_FRAMES):
            assert equal(merged.read_meshes(index, k), example.meshes[k])


def test_order_of_merging_is_the_order_of_scenes(sources: list[Path], tmp_path: Path) -> None:
    """Three datasets merged at once equal the first two merged and then the third."""
    write_examples(new_writer(tmp_path / "e"), [other_ring()])
    merge([*sources, tmp_path / "e"], tmp_path / "at-once")
    merge(sources, tmp_path / "two")
    merge([tmp_path / "two", tmp_path / "e"], tmp_path / "later")
    assert (
        open_dataset(tmp_path / "at-once").fingerprint
        == open_dataset(tmp_path / "later").fingerprint
    )


def test_families_go_on_and_failures_stay(tmp_path: Path) -> None:
    """Plans of families stay plans of families: a merged dataset can be extended, and a scene that
    failed is still known as failed, under its new number."""
    family_dataset(tmp_path / "a", seed=0, count=3)
    family_dataset(tmp_path / "b", seed=1, count=2, failed=(1,))
    merge([tmp_path / "a", tmp_path / "b"], tmp_path / "c")
    merged = open_dataset(tmp_path / "c")
    assert merged.scene_indices == [0, 1, 2, 3]
    assert merged.scenes["seed"].to_pylist() == [0, 0, 0, 1]
    plans = read_plans(LocalStore(tmp_path / "c"))
    assert [(p.family, p.split, p.seed, p.first_number, p.count) for p in plans] == [
        ("rolls", "train", 0, 0, 3),
        ("rolls", "train", 1, 0, 2),
    ]
    writer = open_writer(tmp_path / "c")
    grown = writer.plan_family("rolls", split="train", seed=1, count=3)
    assert [shard.scene_indices for shard in grown] == [(3, 4), (5,)]
    again = [task.scenes for task in writer.tasks("sim", retry_failed=True)]
    assert any(4 in scenes for scenes in again)


def test_duplicates_are_refused_or_skipped(tmp_path: Path) -> None:
    """A scene_id that two datasets have is refused by name; skipping takes the first one only."""
    family_dataset(tmp_path / "a", seed=0, count=2)
    family_dataset(tmp_path / "b", seed=0, count=3)
    both = [tmp_path / "a", tmp_path / "b"]
    with pytest.raises(DatasetError, match=r"rolls train \(seed 0\).*--skip-duplicates"):
        merge(both, tmp_path / "c")
    assert not (tmp_path / "c").exists()
    assert merge(both, tmp_path / "c", skip_duplicates=True).scenes == 3
    merged = open_dataset(tmp_path / "c")
    assert merged.scenes["scene_id"].to_pylist() == [f"rolls-train-s0-{k:06d}" for k in range(3)]
    assert validate(tmp_path / "c").problems == ()


def test_other_configurations_are_refused_unless_mixed(tmp_path: Path) -> None:
    """Layers of another stage are refused by the name of the option; `mixed` keeps both records."""
    write_examples(new_writer(tmp_path / "a"), [RING], layers=("sim",))
    other = StageRecord(name="cubes", version="1", config={"spacing": 0.001})
    writer = new_writer(tmp_path / "b", stages={"sim": other})
    writer.plan_scenes([BARS.scene])
    writer.write(writer.tasks("sim")[0], {0: BARS.particles}, stage=other)
    writer.refresh()
    both = [tmp_path / "a", tmp_path / "b"]
    with pytest.raises(DatasetError, match=r"sim.spacing = 0.00.*--mixed"):
        merge(both, tmp_path / "c")
    merge(both, tmp_path / "c", mixed=True)
    merged = open_dataset(tmp_path / "c")
    spacings = [merged.layer("sim", i).commit.stage.config["spacing"] for i in (0, 1)]
    assert spacings == [0.002, 0.001]
    assert validate(tmp_path / "c", deep=True).problems == ()


def other_ring():
    """The ring under another name, squeezed from another side."""
    scene = replace(RING.scene, scene_id="ring-2", actions=(Action(yaw=0.5),))
    return replace(RING, scene=scene)


def test_near_duplicates_must_not_leak(tmp_path: Path) -> None:
    """A test scene that squeezes the same body in the same way as a training scene is refused."""
    write_examples(new_writer(tmp_path / "a"), [RING], layers=("sim",))
    twin = replace(RING.scene, scene_id="twin", split="test")
    write_examples(new_writer(tmp_path / "b"), [replace(RING, scene=twin)], layers=("sim",))
    with pytest.raises(DatasetError, match=r"closed-form-cut-ring \(train\), twin \(test\)"):
        merge([tmp_path / "a", tmp_path / "b"], tmp_path / "c")
    away = replace(other_ring().scene, split="test")
    write_examples(new_writer(tmp_path / "e"), [replace(RING, scene=away)], layers=("sim",))
    assert merge([tmp_path / "a", tmp_path / "e"], tmp_path / "f").scenes == 2


def test_wrong_requests_are_refused(sources: list[Path], tmp_path: Path) -> None:
    """One source, other numbers of key frames, a target that is a source or something else: each
    is told in one line, and nothing is touched."""
    with pytest.raises(BadInputError, match="two datasets"):
        merge(sources[:1], tmp_path / "c")
    family = new_writer(tmp_path / "long", num_frames=5)
    family.refresh()
    with pytest.raises(DatasetError, match="number of key frames"):
        merge([sources[0], tmp_path / "long"], tmp_path / "c")
    with pytest.raises(DatasetError, match="is read from"):
        merge(sources, sources[0])
    write_examples(new_writer(tmp_path / "there"), [other_ring()])
    before = tree(tmp_path / "there")
    with pytest.raises(DatasetError, match="nothing was touched"):
        merge(sources, tmp_path / "there")
    assert tree(tmp_path / "there") == before
    merge(sources, tmp_path / "c")
    with pytest.raises(DatasetError, match="another request"):
        merge(sources[::-1], tmp_path / "c")


def test_a_damaged_source_is_not_copied(sources: list[Path], tmp_path: Path) -> None:
    """A byte of a source that has flipped stops the copy with its file's name."""
    file = next((sources[1] / "data").rglob("positions/c/0/0/0"))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(DamagedDatasetError, match="positions/c/0/0/0 has changed"):
        merge(sources, tmp_path / "c")


KILLED = """
    import os, signal, sys
    from doughdata.dataset.merge import merge
    from doughdata.dataset.store import LocalStore
    left = int(sys.argv[1])
    def dying(method):
        def run(self, *arguments):
            global left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return method(self, *arguments)
        return run
    for name in ("create", "write_folder", "replace"):
        setattr(LocalStore, name, dying(getattr(LocalStore, name)))
    merge(["a", "b"], "c")
"""


@pytest.mark.parametrize("writes", [1, 5, 12, 22])
def test_killed_at_any_moment_it_resumes(writes: int, sources: list[Path], tmp_path: Path) -> None:
    """A merge that is killed before its n-th write leaves nothing or something that the same
    command completes, equal to one that was never killed."""
    code = [sys.executable, "-c", textwrap.dedent(KILLED), str(writes)]
    done = subprocess.run(code, cwd=tmp_path, check=False)
    assert done.returncode == -signal.SIGKILL
    merge(sources, tmp_path / "c")
    merge(sources, tmp_path / "whole")
    assert validate(tmp_path / "c", deep=True).problems == ()
    assert open_dataset(tmp_path / "c").fingerprint == open_dataset(tmp_path / "whole").fingerprint
    assert [p.name for p in tmp_path.rglob(".tmp-*")] == []


def test_stored_datasets_of_this_version_merge(tmp_path: Path) -> None:
    """The conformance datasets, one with a failed and repeated scene, merge into a valid one."""
    stored = [CONFORMANCE / name / "dataset" for name in ("cubes", "retried")]
    merge(stored, tmp_path / "c", mixed=True)
    assert validate(tmp_path / "c", deep=True).problems == ()
    merged = open_dataset(tmp_path / "c")
    first = open_dataset(stored[0])
    assert len(merged) == len(first) + len(open_dataset(stored[1]))
    for index in first.scene_indices:
        assert equal(merged.read_topology(index), first.read_topology(index))


def recording(folder: Path, scene_id: str) -> RecordedScene:
    """Two images of a table that comes nearer."""
    arrays = {}
    for name, dtype, value in (("depth", np.uint16, 3000), ("segments", np.uint8, 1)):
        kind = {"dtype": np.dtype(dtype), "axes": ("view", "y", "x")}
        with RowSpool(folder / f"{scene_id}-{name}", **kind) as spool:
            for k in range(2):
                spool.add(np.full((32, 40), value - k, dtype))
            arrays[name] = spool.finish(attributes={"depth_unit": 1e-4})
    return RecordedScene(
        scene_id=scene_id,
        camera=CAMERA,
        timestamps=np.array([0.0, 0.1]),
        color=None,
        num_bodies=1,
        opening=np.array([np.nan, 0.05]),
        parameters={"sha256": "ab" * 32, "losses": []},
        **arrays,
    )


def test_recordings_merge_with_simulations(sources: list[Path], tmp_path: Path) -> None:
    """A recording keeps its images, its split and its digest beside simulated scenes, wherever it
    is copied to; dividing a dataset anew leaves it `real`."""
    new_writer(tmp_path / "r", stages={})
    commit_scene(str(tmp_path / "r"), recording(tmp_path, "one"))
    merge([tmp_path / "r", *sources], tmp_path / "c")
    assert validate(tmp_path / "c", deep=True).problems == ()
    merged = open_dataset(tmp_path / "c")
    assert merged.scenes["split"].to_pylist() == ["real", "train", "train"]
    found = merged.read_depth(0, "recorded")
    assert found.depth[:, 0, 0].tolist() == [3000, 2999]
    assert read_plans(LocalStore(tmp_path / "c"))[0].scenes == {"one": "ab" * 32}
    resplit(tmp_path / "c", tmp_path / "d", SplitPlan(test=0.34))
    splits = open_dataset(tmp_path / "d").scenes["split"].to_pylist()
    assert (splits[0], sorted(splits[1:])) == ("real", ["test", "train"])
    subset(tmp_path / "d", tmp_path / "e", SceneFilter(splits=("real",)))
    assert validate(tmp_path / "e", deep=True).problems == ()
    assert open_dataset(tmp_path / "e").scenes["scene_id"].to_pylist() == ["one"]
