"""What is to do: one layer of one shard at a time."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from doughdata.dataset.commits import CommitLog, CommitRecord, StageRecord, upstream_of
from doughdata.dataset.plan import Shard

__all__ = ["Earlier", "Task", "task_for"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One layer of one shard that is to be made. Picklable: it travels to a worker."""

    layer: str  # sim | topology | mesh | depth.<sensor>
    shard: str
    scenes: tuple[int, ...]  # scene_index of the scenes to work on
    revision: int  # 0, or one more than the commit that it replaces
    upstream: Mapping[str, str]  # layer -> hash of the commit that the work reads


@dataclass(frozen=True, slots=True, kw_only=True)
class Earlier:
    """What an earlier revision leaves to be done."""

    commit: CommitRecord | None  # the newest one; None = there is none
    fresh: bool  # whether it still counts: its upstream is what it was
    records: Mapping[int, Any]  # scene_index -> record, of the scenes that need no work


def task_for(
    layer: str,
    shard: Shard,
    log: CommitLog,
    *,
    retry_failed: bool,
    replace_with: StageRecord | None,
) -> Task | None:
    """The task for a layer of a shard, or None if there is nothing to do or to work from."""
    fresh, own = log.fresh(shard.id), log.newest(layer, shard.id)
    needed = upstream_of(layer)
    if any(name not in fresh for name in needed):
        return None
    if layer in fresh:
        again = retry_failed and bool(fresh[layer].failed)
        if replace_with is not None:
            again |= not fresh[layer].stage.same(replace_with)
        if not again:
            return None
    scenes = set(shard.scene_indices)
    for name in needed:
        scenes &= set(fresh[name].scenes)
    if not scenes:
        return None
    return Task(
        layer=layer,
        shard=shard.id,
        scenes=tuple(sorted(scenes)),
        revision=0 if own is None else own.revision + 1,
        upstream={name: fresh[name].hash for name in needed},
    )
