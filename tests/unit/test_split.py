"""Other splits for the same scenes: regions decide, and near-duplicates stay together."""

import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from doughdata.dataset import open_dataset, validate
from doughdata.dataset.duplicates import leaking_groups, near_duplicate_key
from doughdata.dataset.split import SplitPlan, resplit, split_scenes
from doughdata.scenes import load_family, scene_to_json
from doughschemas import BadInputError, DatasetError, Scene
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import equal, new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
REGIONS = ("train", "interpolation", "extrapolation", "custom")


def table(regions: list[str], groups: list[int]) -> pa.Table:
    """A table of scenes; scenes of one group differ in name and material only."""
    rows = []
    for index, (region, group) in enumerate(zip(regions, groups, strict=True)):
        body = replace(RING.scene.bodies[0], yaw=group / 100)
        material = replace(RING.scene.material, young_modulus=1e4 * (1 + index))
        scene = replace(
            RING.scene, scene_id=f"s{index}", bodies=(body,), material=material, region=region
        )
        rows.append(
            {
                "scene_index": index + 10,
                "scene_id": scene.scene_id,
                "region": region,
                "split": "train",
                "parameters": json.dumps(scene_to_json(scene)),
            }
        )
    return pa.Table.from_pylist(rows)


@st.composite
def tables(draw: st.DrawFn) -> pa.Table:
    """Up to 30 scenes; the scenes of a group share their region."""
    groups = draw(st.lists(st.integers(0, 12), min_size=1, max_size=30))
    region = {group: draw(st.sampled_from(REGIONS)) for group in groups}
    return table([region[group] for group in groups], groups)


@given(tables(), st.floats(0, 1), st.floats(0, 1), st.integers(0, 5), st.booleans())
def test_rules_hold_for_any_scenes(
    scenes: pa.Table, test: float, val: float, seed: int, ignore: bool
) -> None:
    """Near-duplicates are never parted, regions are kept unless they are ignored, no share is
    exceeded by free scenes, and neither order nor numbering changes the choice."""
    plan = SplitPlan(test=test * 0.5, val=val * 0.5, seed=seed, ignore_regions=ignore)
    try:
        splits = split_scenes(scenes, plan)
    except DatasetError:
        return  # the shares cannot be met; said in the tests below
    assert sorted(splits) == scenes["scene_index"].to_pylist()
    of_group, free = defaultdict(set), defaultdict(int)
    for row in scenes.to_pylist():
        split = splits[row["scene_index"]]
        of_group[near_duplicate_key(json.loads(row["parameters"]))].add(split)
        if not ignore and row["region"] == "train":
            assert split != "test"
        elif not ignore and row["region"] != "custom":
            assert split == "test"
        else:
            free[split] += 1
    assert all(len(found) == 1 for found in of_group.values())
    assert free["test"] <= round(plan.test * len(scenes))
    shuffled = scenes.take(list(reversed(range(len(scenes)))))
    assert split_scenes(shuffled, plan) == splits


def test_shares_are_met_where_scenes_are_free() -> None:
    """With groups of one scene each and no region, the shares are met exactly; another seed
    chooses others."""
    scenes = table(["custom"] * 40, list(range(40)))
    splits = split_scenes(scenes, SplitPlan(test=0.25, val=0.1))
    assert [list(splits.values()).count(name) for name in ("test", "val", "train")] == [10, 4, 26]
    assert splits != split_scenes(scenes, SplitPlan(test=0.25, val=0.1, seed=1))


def test_a_share_that_regions_forbid_is_refused() -> None:
    """Testing on the training region needs to be asked for by name."""
    scenes = table(["train"] * 10, list(range(10)))
    with pytest.raises(DatasetError, match=r"the regions of all 10 scenes.*--ignore-regions"):
        split_scenes(scenes, SplitPlan(test=0.2))
    assert "val" in split_scenes(scenes, SplitPlan(val=0.2)).values()
    forced = split_scenes(scenes, SplitPlan(test=0.2, ignore_regions=True))
    assert list(forced.values()).count("test") == 2


def test_regions_that_contradict_are_refused() -> None:
    """Near-duplicates of which one must be trained on and one tested on have no split."""
    scenes = table(["train", "extrapolation"], [1, 1])
    with pytest.raises(DatasetError, match="different splits: s0, s1"):
        split_scenes(scenes, SplitPlan())


@pytest.mark.parametrize("shares", [(-0.1, 0.0), (0.7, 0.7), (float("nan"), 0.0)])
def test_shares_must_be_shares(shares: tuple[float, float]) -> None:
    """Shares below 0, above 1 together, or not numbers are refused."""
    with pytest.raises(BadInputError, match=r"0\.\.1"):
        split_scenes(table(["custom"], [0]), SplitPlan(test=shares[0], val=shares[1]))


def sampled(family: str, number: int, split: str = "train") -> Scene:
    return load_family(family).sample(seed=0, number=number, split=split)


def test_near_duplicates_are_what_looks_the_same() -> None:
    """The same squeeze of another material is a near-duplicate; another number, split or a body
    that is a hundredth of a millimetre larger is not."""
    one = near_duplicate_key(scene_to_json(sampled("rolls", 3)))
    assert one == near_duplicate_key(scene_to_json(sampled("rolls?clay", 3)))
    assert one == near_duplicate_key(scene_to_json(replace(sampled("rolls", 3), scene_id="x")))
    others = [sampled("rolls", 4), sampled("rolls", 3, "test")]
    body = sampled("rolls", 3).bodies[0]
    larger = replace(body, parameters={**body.parameters, "radius": 0.02})
    others.append(replace(sampled("rolls", 3), bodies=(larger,)))
    assert all(one != near_duplicate_key(scene_to_json(other)) for other in others)


def test_only_the_split_changes(tmp_path: Path) -> None:
    """The divided dataset has the same records, its `parameters` still name the sampled split,
    and nothing leaks."""
    write_examples(new_writer(tmp_path / "d", scenes_per_shard=2))
    resplit(tmp_path / "d", tmp_path / "new", SplitPlan(test=0.5))
    assert validate(tmp_path / "new", deep=True).problems == ()
    old, new = open_dataset(tmp_path / "d"), open_dataset(tmp_path / "new")
    assert sorted(new.scenes["split"].to_pylist()) == ["test", "train"]
    assert new.info["splits"] == {
        "test": {"scenes": 1, "frames": 3},
        "train": {"scenes": 1, "frames": 3},
    }
    assert new.scenes.drop(["split"]).equals(old.scenes.drop(["split"]))
    for name in ("frames", "tool_poses", "views", "graph_nodes"):
        assert new.table(name).equals(old.table(name))
    assert equal(new.read_particles(1), BARS.particles)
    assert leaking_groups([new.scenes]) == []
