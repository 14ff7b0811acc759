"""Chosen scenes of some datasets become a new one: plans first, then shard after shard.

Everything about the new dataset follows from the request, and every shard is committed by itself:
the same call again goes on where it was stopped, and nothing that was committed is made twice.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from uuid import uuid4

from doughdata.dataset.assets import BODIES, TOOLS
from doughdata.dataset.commits import CommitLog, CommitRecord, StageRecord, read_commit
from doughdata.dataset.documents import dump_document, load_document
from doughdata.dataset.info import DatasetSettings, create_info
from doughdata.dataset.plan import read_plans
from doughdata.dataset.replan import Part, Placement, replan
from doughdata.dataset.selection import format_indices
from doughdata.dataset.shard_copy import ShardCopy, copied_commit, copied_files
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.tables import fingerprint_of
from doughdata.dataset.writer import DatasetWriter
from doughschemas import SCHEMA_VERSION, DatasetError

__all__ = ["ORIGIN", "Copied", "OnScenes", "transfer"]

ORIGIN = "meta/origin.json"
OnScenes = Callable[[int, int], None]  # scenes copied so far, scenes in all


@dataclass(frozen=True, slots=True, kw_only=True)
class Copied:
    """What a new dataset was made of."""

    dataset: str
    scenes: int  # planned in it; those that failed or were not made yet included
    shards: int
    kept: int  # committed layers of shards that an earlier, interrupted call had copied


def transfer(
    operation: str,
    parts: Sequence[Part],
    into: str | Path | Store,
    *,
    stages: Mapping[str, StageRecord],
    on_scenes: OnScenes | None = None,
) -> Copied:
    """Copy the parts into a new dataset, or go on with a copy that was interrupted.

    Args:
        operation: `merge`, `subset` or `split`; kept in `meta/origin.json`.
        parts: what is taken, in this order; all with one number of key frames.
        into: where the new dataset is made.
        stages: layer -> what makes it, for `generate` to go on with.
        on_scenes: hears how far it is.

    Raises:
        DatasetError: there is something else at the target, or the target is a source.
        DamagedDatasetError: a file of a source is missing or has changed.
    """
    store = store_of(into)
    for part in parts:
        if _same_place(part.store, store):
            raise DatasetError(f"{store.uri} is read from; give --into a new folder")
    placements = replan(parts)
    writer = _open(store, _origin(operation, parts), parts[0], stages)
    for placement in placements:
        _publish_plan(store, parts[placement.part], placement)
    total = sum(placement.plan.count for placement in placements)
    done = kept = 0
    log = CommitLog(store)
    for placement in placements:
        for copy in placement.copies:
            kept += _copy_shard(store, parts[placement.part], copy, log)
            done += len(copy.scenes)
            if on_scenes is not None:
                on_scenes(done, total)
    writer.refresh()
    shards = sum(len(placement.copies) for placement in placements)
    return Copied(dataset=store.uri, scenes=total, shards=shards, kept=kept)


def _same_place(one: Store, other: Store) -> bool:
    return one.uri.rstrip("/") == other.uri.rstrip("/") or one.local("") == other.local("")


def _origin(operation: str, parts: Sequence[Part]) -> dict[str, Any]:
    """What the request was: two calls with equal documents make equal datasets."""
    sources = [
        {
            "fingerprint": fingerprint_of(part.log),
            "scenes": format_indices(part.scenes),
            "splits": {str(index): split for index, split in sorted(part.splits.items())},
        }
        for part in parts
    ]
    return {"schema_version": SCHEMA_VERSION, "operation": operation, "sources": sources}


def _open(
    store: Store, origin: Mapping[str, Any], first: Part, stages: Mapping[str, StageRecord]
) -> DatasetWriter:
    """The new dataset, or the one that an earlier call with the same request began."""
    settings = DatasetSettings(
        num_frames=first.dataset.num_frames,
        scenes_per_shard=first.dataset.info["scenes_per_shard"],
        stages=stages,
    )
    if store.exists("meta/info.json") and not store.exists(ORIGIN) and read_plans(store):
        raise DatasetError(
            f"{store.uri} holds a dataset already; give --into a new folder, nothing was touched"
        )
    info = create_info(store, settings)
    store.create(ORIGIN, dump_document(origin))
    there = load_document(store.read(ORIGIN), name=f"{store.uri}: {ORIGIN}")
    if any(there.get(key) != origin[key] for key in ("operation", "sources")):
        raise DatasetError(
            f"{store.uri} was made by another request (or its sources changed since); "
            "give --into a new folder, nothing was touched"
        )
    return DatasetWriter(store, info)


def _publish_plan(store: Store, part: Part, placement: Placement) -> None:
    """A plan record, after the files that it needs."""
    plan = placement.plan
    if placement.texts is not None:
        assert plan.scenes_path is not None
        store.create(plan.scenes_path, placement.texts)
    names = placement.texts.decode() if placement.texts is not None else str(plan.family)
    for path in _assets(part, names):
        store.create(path, part.store.read(path))
    store.create(plan.name, dump_document({"schema_version": SCHEMA_VERSION, **asdict(plan)}))


def _assets(part: Part, text: str) -> list[str]:
    """Meshes of a dataset that a text names."""
    there = [f + name for f in (TOOLS, BODIES) for name in part.store.names(f.rstrip("/"))]
    return [path for path in there if path in text]


def _copy_shard(store: Store, part: Part, copy: ShardCopy, log: CommitLog) -> int:
    """Copy all fresh layers of a shard; returns how many were there already."""
    fresh = part.log.fresh(copy.source)
    hashes: dict[str, str] = {}
    kept = 0
    for layer, commit in fresh.items():
        there = log.newest(layer, copy.target)
        kept += there is not None
        if there is None and not set(commit.upstream) <= set(hashes):
            continue  # no chosen scene came through an earlier layer
        if there is None:
            new = copied_commit(copy, commit, hashes)
            there = None if new is None else _publish(store, copy, commit, fresh, new)
        if there is not None:
            hashes[layer] = there.hash
    return kept


def _publish(
    store: Store,
    copy: ShardCopy,
    commit: CommitRecord,
    fresh: Mapping[str, CommitRecord],
    new: CommitRecord,
) -> CommitRecord:
    """Write a layer's files and its record; returns the record that counts."""
    if new.scenes:
        files = copied_files(copy, commit, fresh.get("sim", commit), new)
        path = f"data/{new.layer}/{new.shard}-{uuid4().hex[:12]}"
        store.write_folder(path, files)
        hashes = {name: sha256(data).hexdigest() for name, data in files.items()}
        new = replace(new, path=path, files=hashes)
    store.create(new.name, new.dump())
    winner = read_commit(store, new.layer, new.shard, new.revision)
    if new.path is not None and winner.path != new.path:
        store.remove(new.path)  # another process was first
    return winner
