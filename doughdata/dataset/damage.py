"""From a file that has changed to the key frames whose rows lie in the damage."""

from pathlib import PurePosixPath

import numpy as np

from doughdata.dataset.arrays import ShardedArray
from doughdata.dataset.commits import CommitRecord, read_commit
from doughdata.dataset.shards import ARRAYS, LayerShard, ShardRows
from doughdata.dataset.store import Store
from doughschemas import DoughError

__all__ = ["damaged_frames"]


def damaged_frames(store: Store, commit: CommitRecord, name: str) -> tuple[tuple[int, int], ...]:
    """(scene_index, frame_index) of the rows of an array file that cannot be decoded.

    Empty for tables, metadata, shard indices and arrays without a chunk per row: what they hold
    belongs to all rows.
    """
    parts = PurePosixPath(name).parts
    if len(parts) < 4 or parts[0] != ARRAYS or parts[2] != "c":
        return ()
    try:
        array = ShardedArray(f"{commit.path}/{ARRAYS}/{parts[1]}", store=store)
        rows = [row for row in range(array.num_chunks) if _is_damaged(array, row)]
        if array.chunk is None or (array.chunk[0] > 1):
            return ()
        return _frames_of(store, commit, rows)
    except (DoughError, LookupError, ValueError):
        return ()  # the index or the metadata is damaged as well


def _is_damaged(array: ShardedArray, row: int) -> bool:
    _ = array.index  # a damaged index is no damaged row
    try:
        array.read_chunk(row)
    except DoughError:
        return True
    return False


def _frames_of(store: Store, commit: CommitRecord, rows: list[int]) -> tuple[tuple[int, int], ...]:
    if commit.layer.startswith("depth."):
        shard = LayerShard(store, commit, ShardRows(scenes=(), num_frames=1))
        views = shard.table("views").table
        scene, frame = (views[c].to_numpy() for c in ("scene_index", "frame_index"))
        return tuple((int(scene[row]), int(frame[row])) for row in rows)
    scenes = commit.scenes if commit.layer == "sim" else _sim_scenes(store, commit)
    total = ShardedArray(f"{commit.path}/{ARRAYS}/{_any_array(commit)}", store=store).shape[0]
    frames = total // len(scenes)
    return tuple((scenes[row // frames], row % frames) for row in np.array(rows, int).tolist())


def _sim_scenes(store: Store, commit: CommitRecord) -> tuple[int, ...]:
    """Scenes of the sim commit that a layer was made from."""
    for name in store.names("meta/commits/sim"):
        shard, revision, _ = name.split(".")
        if shard == commit.shard:
            sim = read_commit(store, "sim", shard, int(revision))
            if sim.hash == commit.upstream.get("sim"):
                return sim.scenes
    return commit.scenes


def _any_array(commit: CommitRecord) -> str:
    paths = (PurePosixPath(name).parts for name in commit.files)
    return next(parts[1] for parts in paths if len(parts) > 2 and parts[0] == ARRAYS)
