"""One shard through one stage: read the layers it needs, work, commit. Runs in a worker."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any, Protocol

from doughdata import registry
from doughdata.dataset import (
    CommitRecord,
    Dataset,
    DatasetWriter,
    Earlier,
    StageRecord,
    Task,
    open_dataset,
)
from doughdata.render.depth import DepthStage
from doughdata.scene_work import (
    check_scene,
    mesh_scene,
    render_scene,
    simulate_scene,
    simulate_scenes,
)
from doughdata.stages import BatchSimulator, Sensor
from doughschemas import DatasetError, MissingPackageError, Scene

__all__ = [
    "Done",
    "RenderShard",
    "ShardStage",
    "ShardWork",
    "config_of",
    "finish",
    "stage_record",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """What became of one task."""

    commit: CommitRecord
    reused: int  # scenes whose record an earlier revision held already


def finish(
    writer: DatasetWriter,
    task: Task,
    stage: StageRecord,
    *,
    earlier: Earlier,
    made: Mapping[int, Any],
    failed: Mapping[int, str],
    scenes: Mapping[int, Scene] | None = None,
) -> Done:
    """Commit what was made and what an earlier revision held.

    Where a retry made nothing new, that revision stays, so that no later layer becomes stale.
    """
    kept = {index: record for index, record in earlier.records.items() if index not in made}
    before = earlier.commit
    if before is not None and earlier.fresh and not made and set(kept) == set(before.scenes):
        return Done(commit=before, reused=len(kept))
    commit = writer.write(task, {**kept, **made}, stage=stage, failed=failed, scenes=scenes)
    return Done(commit=commit, reused=len(kept))


def stage_record(kind: str, stage: Any, **extra: Any) -> StageRecord:
    """What a commit says about the object that made it: registered name, version, configuration."""
    name, version = registry.identity(kind, stage)
    return StageRecord(name=name, version=version, config={**config_of(stage), **extra})


def config_of(stage: Any) -> dict[str, Any]:
    """Configuration of a stage, and of the simulator that was handed to it, as plain values."""
    given = getattr(stage, "config", None)
    config = asdict(given) if is_dataclass(given) and not isinstance(given, type) else {}
    helper = getattr(stage, "pull_apart", None)  # of a check; a simulator has a method of that name
    if helper is None or callable(helper):
        return config
    return {**config, "pull_apart": config_of(helper)}


class ShardWork(Protocol):
    """Works on the tasks of one shard (layer -> task) and commits them. Picklable."""

    @property
    def writer(self) -> DatasetWriter:
        """The dataset that is written."""
        ...

    def __call__(self, tasks: Mapping[str, Task]) -> list[Done]:
        """Work and commit."""
        ...


@dataclass(frozen=True, kw_only=True)
class ShardStage:
    """Simulate, check or mesh all scenes of a task; a scene that fails costs only itself."""

    writer: DatasetWriter
    layer: str
    stage: Any
    record: StageRecord

    def __call__(self, tasks: Mapping[str, Task]) -> list[Done]:
        """Work on the task of this layer and commit it."""
        task = tasks[self.layer]
        earlier = self.writer.earlier(task, self.record)
        scenes = self.writer.scenes(task)
        todo = {index: scene for index, scene in scenes.items() if index not in earlier.records}
        dataset = None if self.layer == "sim" else open_dataset(self.writer.uri)
        records: dict[int, Any] = {}
        failed: dict[int, str] = {}
        together = self._together(todo)
        for index, scene in todo.items():
            try:
                if isinstance(error := together.get(index), Exception):
                    raise error
                records[index] = together.get(index) or self._work(scene, index, dataset)
            except (MissingPackageError, DatasetError):
                raise  # not the scene's fault
            except Exception as error:  # whatever a plug-in does, the other scenes go on
                failed[index] = reason(error)
        results = {"made": records, "failed": failed, "scenes": scenes}
        return [finish(self.writer, task, self.record, earlier=earlier, **results)]

    def _together(self, scenes: Mapping[int, Scene]) -> Mapping[int, Any]:
        """What a simulator made of all scenes at once, if it is one that does so."""
        if isinstance(self.stage, BatchSimulator) and self.stage.batch_size > 1:
            return simulate_scenes(self.stage, scenes)
        return {}

    def _work(self, scene: Scene, index: int, dataset: Dataset | None) -> Any:
        if dataset is None:
            return simulate_scene(self.stage, scene)
        if self.layer == "topology":
            return check_scene(self.stage, scene, dataset, index)
        return mesh_scene(self.stage, dataset, index)


@dataclass(frozen=True, kw_only=True)
class RenderShard:
    """Render the scenes of a shard once and write one layer per sensor."""

    writer: DatasetWriter
    stage: DepthStage
    sensors: Mapping[str, Sensor]
    records: Mapping[str, StageRecord]  # layer -> what makes it

    def __call__(self, tasks: Mapping[str, Task]) -> list[Done]:
        """Work on the tasks of one shard, one a sensor, and commit each."""
        some = next(iter(tasks.values()))
        earlier = {k: self.writer.earlier(task, self.records[k]) for k, task in tasks.items()}
        dataset = open_dataset(self.writer.uri)
        views: dict[str, dict[int, Any]] = {layer: {} for layer in tasks}
        failed: dict[int, str] = {}
        for index, scene in self.writer.scenes(some).items():
            wanted = {
                name: sensor
                for name, sensor in self.sensors.items()
                if (layer := f"depth.{name}") in tasks and index not in earlier[layer].records
            }
            if not wanted:
                continue
            try:
                seen = render_scene(self.stage, wanted, scene, dataset, index)
            except (MissingPackageError, DatasetError):
                raise
            except Exception as error:  # as above: one scene, not the run
                failed[index] = reason(error)
                continue
            for name, record in seen.items():
                views[f"depth.{name}"][index] = record
        return [
            finish(
                self.writer,
                task,
                self.records[layer],
                earlier=earlier[layer],
                made=views[layer],
                failed={i: why for i, why in failed.items() if i not in earlier[layer].records},
            )
            for layer, task in tasks.items()
        ]


def reason(error: Exception) -> str:
    """One line for a commit record."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
