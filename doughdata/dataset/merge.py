"""Several datasets become one: scenes are renumbered, splits and provenance stay."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from doughdata.dataset.commits import StageRecord
from doughdata.dataset.duplicates import leaking_groups
from doughdata.dataset.info import check_stage
from doughdata.dataset.reader import Dataset, open_dataset
from doughdata.dataset.replan import Part
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.transfer import Copied, OnScenes, transfer
from doughschemas import BadInputError, DatasetError

__all__ = ["merge"]


def merge(
    sources: Sequence[str | Path | Store],
    into: str | Path | Store,
    *,
    mixed: bool = False,
    skip_duplicates: bool = False,
    on_scenes: OnScenes | None = None,
) -> Copied:
    """Make a new dataset of all scenes of several, in the order that they are given.

    Scenes that failed or were only planned come along, so `generate` can go on where the sources
    stopped. The same call again resumes.

    Args:
        sources: at least two datasets; nothing in them changes.
        into: where the new dataset is made.
        mixed: allow layers that were made by different stages or configurations. Every commit
            says what made it; `generate` goes on as the first source did.
        skip_duplicates: of scenes with one scene_id take the first; otherwise they are refused.
        on_scenes: hears how far it is.

    Raises:
        BadInputError: fewer than two sources.
        DatasetError: numbers of key frames or stages differ, a scene_id is there twice, or
            near-duplicates would lie in different splits.
        DamagedDatasetError: a file of a source is missing or has changed.
    """
    if len(sources) < 2:
        raise BadInputError(f"merge takes two datasets or more, got {len(sources)}")
    stores = [store_of(source) for source in sources]
    datasets = [open_dataset(store) for store in stores]
    counts = {dataset.uri: dataset.num_frames for dataset in datasets}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{uri} has {count}" for uri, count in counts.items())
        raise DatasetError(f"datasets of one number of key frames can be merged: {told}")
    stages = _stages(datasets, mixed=mixed)
    parts = _parts(datasets, stores, skip_duplicates=skip_duplicates)
    _refuse_leaks(parts)
    return transfer("merge", parts, into, stages=stages, on_scenes=on_scenes)


def _stages(datasets: Sequence[Dataset], *, mixed: bool) -> dict[str, StageRecord]:
    """Layer -> what makes it; the first dataset that has a layer decides."""
    stages: dict[str, StageRecord] = {}
    for dataset in datasets:
        for layer, made in dataset.info["stages"].items():
            record = StageRecord(**made)
            if not mixed and layer in stages:
                _check(dataset, layer, stages[layer], record)
            stages.setdefault(layer, record)
    return stages


def _check(dataset: Dataset, layer: str, first: StageRecord, other: StageRecord) -> None:
    try:
        check_stage(dataset.uri, layer, other.to_json(), first)
    except DatasetError as error:
        told = str(error).partition(";")[0]
        raise DatasetError(f"{told}; --mixed merges them all the same") from error


def _parts(
    datasets: Sequence[Dataset], stores: Sequence[Store], *, skip_duplicates: bool
) -> list[Part]:
    """What is taken from each; scenes that an earlier one has are refused or skipped."""
    taken: dict[str, str] = {}  # scene_id, or a family's plan -> the dataset that gives it
    parts = []
    for dataset, store in zip(datasets, stores, strict=True):
        columns = (dataset.scenes[name].to_pylist() for name in ("scene_index", "scene_id"))
        ids = dict(zip(*columns, strict=True))
        part = Part.of(dataset, store)
        # A plan starts at number 0, so that two of one family, split and seed share scenes.
        sampled = [plan for plan in part.plans if plan.seed is not None]
        plans = {f"{plan.family} {plan.split} (seed {plan.seed})" for plan in sampled}
        double = sorted({*ids.values(), *plans} & set(taken))
        if double and not skip_duplicates:
            raise DatasetError(
                f"{dataset.uri} has {double[0]}, as {taken[double[0]]} has; --skip-duplicates "
                "takes the first of scenes with one scene_id, another --seed makes other scenes"
            )
        if double:
            part = replace(
                part, scenes=frozenset(i for i, name in ids.items() if name not in taken)
            )
        taken |= {name: dataset.uri for name in (*ids.values(), *plans) if name not in taken}
        parts.append(part)
    return parts


def _refuse_leaks(parts: Sequence[Part]) -> None:
    tables = [part.dataset.scenes for part in parts]
    kept = [
        table.filter(pa.array(np.isin(table["scene_index"].to_numpy(), list(part.scenes))))
        for table, part in zip(tables, parts, strict=True)
    ]
    leaks = leaking_groups(kept)
    if leaks:
        told = ", ".join(f"{name} ({split})" for name, split in sorted(leaks[0].items())[:4])
        raise DatasetError(
            f"near-duplicates would lie in different splits: {told}"
            + (f" and {len(leaks) - 1} more groups" if len(leaks) > 1 else "")
            + "; give them one split (`doughdata split`) or leave some out (`doughdata subset`)"
        )
