"""Some scenes become a dataset of their own, and hold exactly what they held before."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from doughdata.dataset import open_dataset, open_writer, validate
from doughdata.dataset.documents import dump_document
from doughdata.dataset.plan import read_plans
from doughdata.dataset.selection import SceneFilter, format_indices, parse_indices
from doughdata.dataset.store import LocalStore
from doughdata.dataset.subset import subset
from doughschemas import BadInputError, DatasetError, MissingLayerError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import STAGES, equal, new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
IDS = (RING.scene.scene_id, BARS.scene.scene_id, "second")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ring, bars and a second ring in one shard; the last failed in the mesh."""
    path = tmp_path_factory.mktemp("source") / "d"
    actions = (replace(RING.scene.actions[0], yaw=0.5),)
    scene = replace(RING.scene, scene_id="second", split="test", actions=actions)
    second = replace(RING, scene=scene)
    examples = [RING, BARS, second]
    write_examples(
        new_writer(path, scenes_per_shard=4), examples, failed={"mesh": {2: "no surface"}}
    )
    return path


@pytest.mark.parametrize("kept", [(0,), (1,), (0, 1), (1, 2), (0, 1, 2)])
def test_records_of_chosen_scenes_are_equal(
    kept: tuple[int, ...], source: Path, tmp_path: Path
) -> None:
    """Whichever scenes of a shard are taken, their records are bit for bit those of the source."""
    subset(source, tmp_path / "few", SceneFilter(scenes=kept))
    assert validate(tmp_path / "few", deep=True).problems == ()
    few = open_dataset(tmp_path / "few")
    for new, old in enumerate(kept):
        example = (RING, BARS, RING)[old]
        assert few.scenes["scene_id"][new].as_py() == IDS[old]
        assert equal(few.read_particles(new), example.particles)
        assert equal(few.read_topology(new), example.topology)
        if old == 2:  # it failed: still known, with its reason
            with pytest.raises(MissingLayerError, match="no surface"):
                few.read_meshes(new, 0)
            continue
        assert equal(few.read_depth(new, "none"), example.depth)
        for k in range(NUM_FRAMES):
            assert equal(few.read_meshes(new, k), example.meshes[k])


CHOICES = {
    "a split": (SceneFilter(splits=("test",)), [2]),
    "a final topology": (SceneFilter(final=("c=1 g=0",)), [1]),
    "components alone": (SceneFilter(final=("c=2",)), [0, 2]),
    "an event": (SceneFilter(events=("merge",)), [1]),
    "two conditions": (SceneFilter(final=("c=2",), splits=("train",)), [0]),
    "two values": (SceneFilter(splits=("train", "test"), families=("custom",)), [0, 1, 2]),
}


@pytest.mark.parametrize("what", CHOICES)
def test_conditions_choose(what: str, source: Path) -> None:
    """A scene is taken if it satisfies every condition, with one of the values that are given."""
    wanted, expected = CHOICES[what]
    assert wanted.choose(open_dataset(source)) == expected


WRONG = {
    "no condition": (SceneFilter(), "at least one condition"),
    "a scene": (SceneFilter(scenes=(7,)), r"no scene 7 \(it has: 0, 1, 2\)"),
    "a family": (SceneFilter(families=("donut",)), r"no family 'donut' \(it has: custom\)"),
    "an end": (SceneFilter(final=("c=9",)), "no final topology 'c=9'"),
    "nothing left": (SceneFilter(scenes=(1,), final=("c=2",)), "no scene satisfies"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_conditions_are_told(what: str, source: Path, tmp_path: Path) -> None:
    """A condition about something that is not there names what there is; nothing is made."""
    wanted, message = WRONG[what]
    with pytest.raises(BadInputError, match=message):
        subset(source, tmp_path / "few", wanted)
    assert list(tmp_path.iterdir()) == []


@given(st.sets(st.integers(0, 200)))
def test_indices_as_text_come_back(indices: set[int]) -> None:
    """The text form of any set of indices means that very set."""
    if indices:
        assert parse_indices(format_indices(indices)) == tuple(sorted(indices))


@pytest.mark.parametrize("text", ["", "1,,2", "a", "3-1", "-1", "1.5", "1-2-3"])
def test_other_texts_are_refused(text: str) -> None:
    """What is no list of indices and rising ranges is refused."""
    with pytest.raises(BadInputError):
        parse_indices(text)


def test_a_family_can_be_extended_only_from_its_start(tmp_path: Path) -> None:
    """The first scenes of a family stay that family's plan; later ones are written out, so that
    nothing that `generate` plans afterwards has the number of another scene."""
    writer = new_writer(tmp_path / "d", scenes_per_shard=2)
    writer.plan_family("rolls", split="train", seed=0, count=5)
    for task in writer.tasks("sim"):
        writer.write(task, dict.fromkeys(task.scenes, RING.particles), stage=STAGES["sim"])
    writer.refresh()
    subset(tmp_path / "d", tmp_path / "first", SceneFilter(scenes=(0, 1, 2)))
    subset(tmp_path / "d", tmp_path / "later", SceneFilter(scenes=(1, 3, 4)))
    first, later = (read_plans(LocalStore(tmp_path / name)) for name in ("first", "later"))
    assert [(plan.family, plan.count) for plan in first] == [("rolls", 3)]
    assert [plan.family for plan in later] == [None]
    assert validate(tmp_path / "later", deep=True).problems == ()
    names = [f"rolls-train-s0-{number:06d}" for number in (1, 3, 4)]
    assert open_dataset(tmp_path / "later").scenes["scene_id"].to_pylist() == names
    grown = open_writer(tmp_path / "first").plan_family("rolls", split="train", seed=0, count=4)
    assert [shard.scene_indices for shard in grown][-1] == (3,)
    # Scene 1 is there already, written out: sampled again, it would have two places.
    writer = open_writer(tmp_path / "later")
    with pytest.raises(DatasetError, match=r"rolls-train-s0-000001.*another --seed"):
        writer.plan_family("rolls", split="train", seed=0, count=2)
    assert len(writer.plan_family("rolls", split="train", seed=0, count=1)) == 1
    assert len(writer.plan_family("rolls", split="train", seed=1, count=2)) == 1


def test_the_origin_is_watched(source: Path, tmp_path: Path) -> None:
    """A changed or nonsensical `meta/origin.json` is a problem that `validate` names."""
    subset(source, tmp_path / "new", SceneFilter(scenes=(0,)))
    path = tmp_path / "new/meta/origin.json"
    good = path.read_bytes()
    assert validate(tmp_path / "new").problems == ()
    path.write_bytes(good.replace(b"subset", b"sunset"))
    (problem,) = validate(tmp_path / "new").problems
    assert (problem.file, "checksum" in problem.message) == ("meta/origin.json", True)
    path.write_bytes(dump_document({**json.loads(good), "operation": "sunset"}))
    (problem,) = validate(tmp_path / "new").problems
    assert (problem.file, "sunset" in problem.message) == ("meta/origin.json", True)


def test_meshes_of_tools_come_along(tmp_path: Path) -> None:
    """A scene whose tool is a mesh finds it in the new dataset, under the same name."""
    import trimesh

    blade = trimesh.creation.box(extents=(0.01, 0.01, 0.05))
    blade.apply_translation((0.005, 0.0, 0.025))
    blade.export(tmp_path / "blade.glb")
    tool = replace(RING.scene.tools[0], mesh=str(tmp_path / "blade.glb"))
    scene = replace(RING.scene, scene_id="blade", tools=(tool,))
    examples = [replace(RING, scene=scene), BARS]
    write_examples(new_writer(tmp_path / "d"), examples, layers=("sim",))
    subset(tmp_path / "d", tmp_path / "few", SceneFilter(scenes=(0,)))
    copied = open_dataset(tmp_path / "few").scene(0).tools[0].mesh
    assert copied is not None
    assert Path(copied).is_relative_to(tmp_path / "few/assets/tools")
    assert Path(copied).read_bytes() == next((tmp_path / "d/assets/tools").iterdir()).read_bytes()


def test_the_target_must_be_new(source: Path, tmp_path: Path) -> None:
    """A subset goes on with itself, never with another one."""
    subset(source, tmp_path / "few", SceneFilter(scenes=(0,)))
    assert subset(source, tmp_path / "few", SceneFilter(scenes=(0,))).kept == 4
    with pytest.raises(DatasetError, match="another request"):
        subset(source, tmp_path / "few", SceneFilter(scenes=(1,)))
