"""A finished conversion becomes a scene of a dataset: all of it, or nothing."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

from doughdata import __version__
from doughdata.dataset import DatasetSettings, StageRecord, Task, open_writer
from doughdata.dataset.commits import RECORDED, CommitLog
from doughdata.dataset.documents import plain_json
from doughdata.dataset.layers import RecordedScene
from doughdata.dataset.plan_recorded import find_recording, plan_recording
from doughdata.dataset.shards import LayerShard, ShardRows
from doughdata.dataset.store import Store, store_of
from doughdata.recordings.protocol import Conversion, Loss
from doughdata.registry import identity
from doughschemas import DatasetError, DoughError

__all__ = ["commit_scene", "digest_of", "known_scene", "origin_of", "room_for"]

INFO = "meta/info.json"
LEAST_FRAMES = 75  # key frames of a new dataset, as `generate` makes it


def digest_of(path: Path) -> str:
    """Hex sha256 of a file; of a folder, of its files' names and digests."""
    if not path.is_dir():
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    digest = sha256()
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        digest.update(f"{file.relative_to(path).as_posix()} {digest_of(file)}\n".encode())
    return digest.hexdigest()


def origin_of(converter: object, path: Path, options: Mapping[str, Any]) -> dict[str, Any]:
    """Where a scene comes from and how it is made: the beginning of its `parameters`."""
    return plain_json(
        {
            "recording": path.name,
            "sha256": digest_of(path),
            "converter": identity("converters", converter)[0],
            "options": options,
        }
    )


def known_scene(dataset: str, origin: Mapping[str, Any]) -> Conversion | None:
    """What an earlier conversion of the same bytes with the same options did, if there was one."""
    store = store_of(dataset)
    if not store.exists(INFO):
        return None
    found = find_recording(store, origin["sha256"])
    commit = CommitLog(store).newest(RECORDED, found[1].id) if found else None
    if commit is None or commit.path is None:
        return None
    index = commit.scenes[0]
    scene = LayerShard(store, commit, ShardRows(scenes=commit.scenes, num_frames=1)).table("scenes")
    row = scene.table.to_pylist()[0]
    parameters = json.loads(row["parameters"])
    if any(parameters[key] != origin[key] for key in ("converter", "options")):
        return None
    losses = (Loss(**loss) for loss in parameters["losses"])
    return Conversion(
        dataset=dataset,
        scenes=(index,),
        frames=row["num_frames"],
        losses=tuple(losses),
        warnings=("this recording is in the dataset already, converted in the same way",),
    )


def room_for(dataset: str) -> int | None:
    """Key frames that a scene of the dataset has; None = it is not there yet.

    Raises:
        DatasetError: the place holds something else.
    """
    store = store_of(dataset)
    if store.exists(INFO):
        return int(open_writer(store).num_frames)
    if store.is_file(""):
        raise DatasetError(f"{dataset} is a file; a dataset is a folder")
    if strangers := store.names(""):
        raise DatasetError(
            f"{dataset} holds something else ({strangers[0]}) and no dataset; choose an empty or "
            "new folder, nothing was touched"
        )
    return None


def commit_scene(dataset: str, record: RecordedScene) -> int:
    """Write a recording's layer and commit it; returns its scene_index.

    A scene that the dataset has of the same recording is replaced. A dataset that this call made
    is removed again if the layer cannot be committed.

    Raises:
        DatasetError: the disk is full or read-only, or the place holds something else.
    """
    store = store_of(dataset)
    new = not store.exists(INFO)
    frames = max(LEAST_FRAMES, len(record.timestamps)) if new else None
    # One stage for all recordings: how each was converted stands in its `parameters`.
    stage = StageRecord(name="recorded", version=__version__)
    try:
        writer = open_writer(store, DatasetSettings(num_frames=frames))
        name, shard = plan_recording(store, record.scene_id, record.parameters["sha256"])
        before = CommitLog(store).newest(RECORDED, shard.id)
        task = Task(
            layer=RECORDED,
            shard=shard.id,
            scenes=shard.scene_indices,
            revision=0 if before is None else before.revision + 1,
            upstream={},
        )
        index = shard.scene_indices[0]
        writer.write(task, {index: replace(record, scene_id=name)}, stage=stage)
        writer.refresh()
    except BaseException:
        if new:
            _remove_beginning(store)
        raise
    return index


def _remove_beginning(store: Store) -> None:
    """Take back a dataset that this call began and in which nobody has committed anything."""
    with suppress(DoughError, OSError):
        if CommitLog(store).shards:
            return
        for name in store.names(""):
            store.remove(name)
        folder = store.local("")
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
