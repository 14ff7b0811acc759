"""What the commit that a task replaces already holds, so that no good scene is made again.

A scene's record can be taken over when the same stage made it and what it was made from is still
the same, bit for bit. That is so for the good scenes of a shard in which another one failed, and in
all later layers of such a shard, which only became stale because their neighbour was renewed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from doughdata.dataset.commits import (
    CommitLog,
    CommitRecord,
    StageRecord,
    all_revisions,
    read_commit,
)
from doughdata.dataset.layers import (
    decode_depth,
    decode_label_grid,
    decode_meshes,
    decode_particles,
    decode_topology,
)
from doughdata.dataset.shards import LayerShard, ShardRows
from doughdata.dataset.store import Store
from doughschemas import ComponentMeshes, DamagedDatasetError

__all__ = ["earlier_records", "equal_records"]

Commits = Mapping[str, CommitRecord]  # layer -> commit


def earlier_records(
    store: Store,
    commit: CommitRecord,
    stage: StageRecord,
    scenes: Sequence[int],
    *,
    num_frames: int,
) -> dict[int, Any]:
    """scene_index -> record, of those scenes of a commit that need not be made again.

    Args:
        store: of the dataset.
        commit: the newest one of its layer and shard; it may be stale.
        stage: what would make the scenes now; another version makes everything again.
        scenes: scene_index of those that are wanted.
        num_frames: key frames a scene.
    """
    if commit.path is None or commit.stage.to_json() != stage.to_json():
        return {}
    earlier = _Earlier(store, commit, num_frames=num_frames)
    try:
        return {i: earlier.record(i) for i in scenes if i in commit.scenes and earlier.holds(i)}
    except DamagedDatasetError:
        return {}  # removed by `gc`, or damaged: then it is made again


class _Earlier:
    """A commit, what it was made from, and what it would be made from now."""

    def __init__(self, store: Store, commit: CommitRecord, *, num_frames: int) -> None:
        self._store, self._commit, self._num_frames = store, commit, num_frames
        self._now = CommitLog(store).fresh(commit.shard)

    @cached_property
    def _before(self) -> Commits:
        return {name: self._of_hash(name, digest) for name, digest in self._commit.upstream.items()}

    def record(self, index: int) -> Any:
        """One scene, as the writer takes it."""
        return self._record(self._commit, self._before, index)

    def holds(self, index: int) -> bool:
        """Whether the records that a scene was made from are the same today."""
        for name, old in self._before.items():
            new = self._now.get(name)
            if new is None or index not in new.scenes or index not in old.scenes:
                return False
            if new.hash != old.hash and not equal_records(
                self._record(old, self._before, index), self._record(new, self._now, index)
            ):
                return False
        return True

    def _of_hash(self, layer: str, digest: str) -> CommitRecord:
        """The revision that an upstream hash names."""
        shard = self._commit.shard
        for revision in all_revisions(self._store, layer).get(shard, []):
            found = read_commit(self._store, layer, shard, revision)
            if found.hash == digest:
                return found
        raise DamagedDatasetError(f"{self._store.uri}: no revision {digest} of {layer} {shard}")

    def _record(self, commit: CommitRecord, others: Commits, index: int) -> Any:
        kind = commit.layer.partition(".")[0]
        if kind == "depth":  # its rows are views, whatever the order of the scenes
            rows = ShardRows(scenes=commit.scenes, num_frames=self._num_frames)
            return decode_depth(LayerShard(self._store, commit, rows), index)
        sim = commit if kind == "sim" else self._sim_of(commit, others)
        rows = ShardRows(scenes=sim.scenes, num_frames=self._num_frames)
        shard = LayerShard(self._store, commit, rows)
        if kind == "sim":
            return decode_particles(shard, index)
        if kind == "topology":
            counts = LayerShard(self._store, sim, rows).array("num_particles")
            return decode_topology(shard, index, num_particles=int(counts.row(rows.start(index))))
        return [
            ComponentMeshes(
                meshes=decode_meshes(shard, index, frame),
                label_grid=decode_label_grid(shard, index, frame),
            )
            for frame in range(self._num_frames)
        ]

    def _sim_of(self, commit: CommitRecord, others: Commits) -> CommitRecord:
        """The `sim` commit whose rows a layer follows."""
        digest = commit.upstream["sim"]
        sim = others.get("sim")
        return sim if sim is not None and sim.hash == digest else self._of_hash("sim", digest)


def equal_records(a: Any, b: Any) -> bool:
    """Whether two records hold the same values, dtypes and shapes, bit for bit."""
    if is_dataclass(a):
        return type(a) is type(b) and all(
            equal_records(getattr(a, field.name), getattr(b, field.name)) for field in fields(a)
        )
    if isinstance(a, np.ndarray):
        return (a.dtype, a.shape) == (b.dtype, b.shape) and a.tobytes() == b.tobytes()
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(equal_records, a, b))
    return a == b
