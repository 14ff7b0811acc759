"""Maps work over shards: lists what is to do, hears commits, settles workers that died."""

from collections.abc import Mapping, Sequence

from doughdata.dataset import DatasetWriter, Shard, StageRecord, Task
from doughdata.executors import WorkerCrash
from doughdata.requests import Listener, Summary
from doughdata.shard_tasks import Done, ShardWork, finish
from doughdata.stages import Executor

__all__ = ["over_shards"]


def over_shards(
    work: ShardWork,
    records: Mapping[str, StageRecord],
    shards: Sequence[Shard],
    executor: Executor,
    *,
    summary: Summary,
    listener: Listener,
    retry_failed: bool = False,
) -> Summary:
    """Let an executor work on every shard that lacks a layer; returns the summary, extended.

    Args:
        work: what is done with the tasks of one shard.
        records: layer -> stage that makes it; the layers of one shard are worked on together.
        shards: where to look for work.
        executor: where to work; it is open.
        summary: of the run so far.
        listener: hears how far it is.
        retry_failed: also work on shards in which a scene failed before.
    """
    todo: dict[str, dict[str, Task]] = {}
    for layer in records:
        for task in work.writer.tasks(layer, shards=shards, retry_failed=retry_failed):
            todo.setdefault(task.shard, {})[layer] = task
    counts = {layer: _Count() for layer in records}
    total = sum(len(shard.scene_indices) for shard in shards)
    for layer in records:
        open_scenes = sum(len(tasks[layer].scenes) for tasks in todo.values() if layer in tasks)
        counts[layer].kept = total - open_scenes
        listener.start(layer, total=total, done=total - open_scenes)
    for result in executor.map(work, list(todo.values())):
        finished = (
            _settled(work.writer, result, records) if isinstance(result, WorkerCrash) else result
        )
        for done in finished:
            commit = done.commit
            counts[commit.layer].add(done)
            listener.advance(commit.layer, len(commit.scenes) + len(commit.failed))
    for layer, count in counts.items():
        summary = summary.with_layer(layer, made=count.made, kept=count.kept, failed=count.failed)
    return summary


class _Count:
    """Scenes of one layer."""

    def __init__(self) -> None:
        self.made, self.kept = 0, 0
        self.failed: dict[int, str] = {}

    def add(self, done: Done) -> None:
        self.made += len(done.commit.scenes) - done.reused
        self.kept += done.reused
        self.failed.update(done.commit.failed)


def _settled(
    writer: DatasetWriter, crash: WorkerCrash, records: Mapping[str, StageRecord]
) -> list[Done]:
    """Commit that every scene of a crashed shard failed, save those that were good before."""
    tasks: Mapping[str, Task] = crash.item
    finished = []
    for layer, task in tasks.items():
        earlier = writer.earlier(task, records[layer])
        before = earlier.commit
        if before is not None and earlier.fresh and before.scenes:  # a retry: keep what was good
            finished.append(Done(commit=before, reused=len(before.scenes)))
            continue
        failed = {i: crash.reason for i in task.scenes if i not in earlier.records}
        results = {"made": {}, "failed": failed}
        finished.append(finish(writer, task, records[layer], earlier=earlier, **results))
    return finished
