"""Other splits for the same scenes, without leaks.

Two rules. A region decides: scenes of the training region are never tested on, scenes of the test
regions are never trained on; only `custom` ones are free. And near-duplicates stay together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from doughdata.dataset.commits import StageRecord
from doughdata.dataset.duplicates import duplicate_groups
from doughdata.dataset.reader import open_dataset
from doughdata.dataset.replan import Part
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.transfer import Copied, OnScenes, transfer
from doughdata.seeds import seed_sequence
from doughschemas import BadInputError, DatasetError

__all__ = ["SplitPlan", "resplit", "split_scenes"]

TRAIN, VAL, TEST = "train", "val", "test"
ALLOWED = {  # region -> splits that its scenes may be in
    "train": (TRAIN, VAL),
    "interpolation": (TEST,),
    "extrapolation": (TEST,),
}
ANY = (TRAIN, VAL, TEST)


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitPlan:
    """How scenes are divided. Shares are of all scenes, and met as near as whole groups allow."""

    test: float = 0.0
    val: float = 0.0
    seed: int = 0
    ignore_regions: bool = False  # scenes of any region may get any split


def resplit(
    source: str | Path | Store,
    into: str | Path | Store,
    plan: SplitPlan,
    *,
    on_scenes: OnScenes | None = None,
) -> Copied:
    """Make a new dataset of the same scenes with other splits. The same call again resumes.

    Only the column `split` differs: `region` and `parameters` still say how a scene was sampled.

    Raises:
        BadInputError: shares outside 0..1, or together more than 1.
        DatasetError: the regions leave too few scenes for a share; or something else is at the
            target.
        DamagedDatasetError: a file of the source is missing or has changed.
    """
    store = store_of(source)
    dataset = open_dataset(store)
    part = Part.of(dataset, store, splits=split_scenes(dataset.scenes, plan))
    stages = {layer: StageRecord(**made) for layer, made in dataset.info["stages"].items()}
    return transfer("split", [part], into, stages=stages, on_scenes=on_scenes)


def split_scenes(scenes: pa.Table, plan: SplitPlan) -> dict[int, str]:
    """scene_index -> split, for every row of a table of scenes. Raises as `resplit` does."""
    if not (plan.test >= 0 and plan.val >= 0 and plan.test + plan.val <= 1):
        raise BadInputError(
            f"shares lie within 0..1 and add up to 1 at most, got {plan.test:g} and {plan.val:g}"
        )
    indices = scenes["scene_index"].to_pylist()
    groups = duplicate_groups(scenes)
    places = list(zip(*(scenes[name].to_pylist() for name in ("region", "split")), strict=True))
    allowed = {key: _allowed([places[row] for row in rows], plan) for key, rows in groups.items()}
    if stuck := [groups[key] for key, names in allowed.items() if not names]:
        ids = [scenes["scene_id"][row].as_py() for row in stuck[0]]
        raise DatasetError(
            f"near-duplicates lie in regions of different splits: {', '.join(ids[:4])}; leave one "
            "out with `doughdata subset`, or give --ignore-regions"
        )
    chosen = _choose(groups, allowed, plan, total=len(indices))
    return {indices[row]: chosen[key] for key, rows in groups.items() for row in rows}


def _allowed(places: Sequence[tuple[str, str]], plan: SplitPlan) -> tuple[str, ...]:
    """Splits that a group of near-duplicates, each with its region and split, may be in."""
    kept = {split for _, split in places if split not in ANY}  # recordings stay `real`
    if kept:
        return tuple(kept) if len(kept) == 1 else ()
    if plan.ignore_regions:
        return ANY
    sets = [set(ALLOWED.get(region, ANY)) for region, _ in places]
    return tuple(name for name in ANY if all(name in names for names in sets))


def _choose(
    groups: Mapping[str, Sequence[int]],
    allowed: Mapping[str, Sequence[str]],
    plan: SplitPlan,
    *,
    total: int,
) -> dict[str, str]:
    """Group -> split: what has no choice first, then groups in random order while they fit."""
    chosen = {key: names[0] for key, names in allowed.items() if len(names) == 1}
    rng = np.random.default_rng(seed_sequence(plan.seed, "split"))
    keys = sorted(groups)  # by content: neither the order of the scenes nor their numbers matter
    order = [keys[k] for k in rng.permutation(len(keys))]
    for name, share in ((TEST, plan.test), (VAL, plan.val)):
        wanted = round(share * total)
        have = sum(len(groups[key]) for key, split in chosen.items() if split == name)
        free = [key for key in order if key not in chosen and name in allowed[key]]
        for key in free:
            if have + len(groups[key]) <= wanted:
                chosen[key] = name
                have += len(groups[key])
        if share and not have:
            raise DatasetError(_refusal(name, share, free, allowed, total))
    return {key: chosen.get(key, TRAIN) for key in groups}


def _refusal(
    name: str, share: float, free: Sequence[str], allowed: Mapping[str, Sequence[str]], total: int
) -> str:
    if free or any(name in names for names in allowed.values()):
        return (
            f"{share:g} of {total} scenes is less than one group of near-duplicates; "
            f"ask for more --{name}"
        )
    return (
        f"no scene may be in {name!r}: the regions of all {total} scenes decide their split; "
        "make scenes with `doughdata generate --split test`, or give --ignore-regions"
    )
