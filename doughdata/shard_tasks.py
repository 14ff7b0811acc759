"""One shard through one stage: read the layers it needs, work, commit. Runs in a worker."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any, Protocol

import numpy as np

from doughdata import registry
from doughdata.dataset import CommitRecord, Dataset, DatasetWriter, StageRecord, Task, open_dataset
from doughdata.render.depth import DepthStage
from doughdata.seeds import seed_sequence
from doughdata.stages import Sensor
from doughschemas import ComponentMeshes, DatasetError, MissingPackageError, Scene

__all__ = ["RenderShard", "ShardStage", "ShardWork", "config_of", "stage_record"]


def stage_record(kind: str, stage: Any, **extra: Any) -> StageRecord:
    """What a commit says about the object that made it: registered name, version, configuration."""
    name, version = registry.identity(kind, stage)
    return StageRecord(name=name, version=version, config={**config_of(stage), **extra})


def config_of(stage: Any) -> dict[str, Any]:
    """Configuration of a stage, and of the simulator that was handed to it, as plain values."""
    given = getattr(stage, "config", None)
    config = asdict(given) if is_dataclass(given) and not isinstance(given, type) else {}
    helper = getattr(stage, "pull_apart", None)
    return config if helper is None else {**config, "pull_apart": config_of(helper)}


class ShardWork(Protocol):
    """Works on the tasks of one shard (layer -> task) and commits them. Picklable."""

    @property
    def writer(self) -> DatasetWriter:
        """The dataset that is written."""
        ...

    def __call__(self, tasks: Mapping[str, Task]) -> list[CommitRecord]:
        """Work and commit."""
        ...


@dataclass(frozen=True, kw_only=True)
class ShardStage:
    """Simulate, check or mesh all scenes of a task; a scene that fails costs only itself."""

    writer: DatasetWriter
    layer: str
    stage: Any
    record: StageRecord

    def __call__(self, tasks: Mapping[str, Task]) -> list[CommitRecord]:
        """Work on the task of this layer and commit it."""
        task = tasks[self.layer]
        scenes = self.writer.scenes(task)
        work = {"sim": self._simulate, "topology": self._check, "mesh": self._mesh}[self.layer]
        dataset = None if self.layer == "sim" else open_dataset(self.writer.uri)
        records, failed = {}, {}
        for index, scene in scenes.items():
            try:
                records[index] = work(scene, index, dataset)
            except (MissingPackageError, DatasetError):
                raise  # not the scene's fault
            except Exception as error:  # whatever a plug-in does, the other scenes go on
                failed[index] = reason(error)
        return [self.writer.write(task, records, stage=self.record, failed=failed, scenes=scenes)]

    def _simulate(self, scene: Scene, index: int, dataset: Dataset | None) -> Any:
        del index, dataset
        rng = np.random.default_rng(seed_sequence(scene.seed, scene.scene_id, "simulate"))
        return self.stage.simulate(scene, rng=rng)

    def _check(self, scene: Scene, index: int, dataset: Dataset | None) -> Any:
        assert dataset is not None
        return self.stage.check(scene, dataset.read_particles(index))

    def _mesh(self, scene: Scene, index: int, dataset: Dataset | None) -> Any:
        del scene
        assert dataset is not None
        particles, topology = dataset.read_particles(index), dataset.read_topology(index)
        return [
            self.stage.mesh(positions, frame, spacing=particles.spacing)
            for positions, frame in zip(particles.positions, topology.frames, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class RenderShard:
    """Render the scenes of a shard once and write one layer per sensor."""

    writer: DatasetWriter
    stage: DepthStage
    sensors: Mapping[str, Sensor]
    records: Mapping[str, StageRecord]  # layer -> what makes it

    def __call__(self, tasks: Mapping[str, Task]) -> list[CommitRecord]:
        """Work on the tasks of one shard, one a sensor, and commit each."""
        some = next(iter(tasks.values()))
        wanted = {name: s for name, s in self.sensors.items() if f"depth.{name}" in tasks}
        dataset = open_dataset(self.writer.uri)
        views: dict[str, dict[int, Any]] = {layer: {} for layer in tasks}
        failed: dict[int, str] = {}
        for index, scene in self.writer.scenes(some).items():
            poses = dataset.read_particles(index).tool_poses
            meshes = _SceneMeshes(dataset, index)
            try:
                seen = self.stage.views(scene, poses, meshes, sensors=wanted)
            except (MissingPackageError, DatasetError):
                raise
            except Exception as error:  # as above: one scene, not the run
                failed[index] = reason(error)
                continue
            for name, record in seen.items():
                views[f"depth.{name}"][index] = record
        return [
            self.writer.write(task, views[layer], stage=self.records[layer], failed=failed)
            for layer, task in tasks.items()
        ]


class _SceneMeshes(Mapping[int, ComponentMeshes]):
    """The meshes of one scene, read frame by frame when asked for."""

    def __init__(self, dataset: Dataset, scene: int) -> None:
        self._frame: Callable[[int], ComponentMeshes] = lambda k: dataset.read_meshes(scene, k)
        self._length = dataset.num_frames

    def __getitem__(self, frame: int) -> ComponentMeshes:
        return self._frame(frame)

    def __iter__(self) -> Iterator[int]:
        return iter(range(self._length))

    def __len__(self) -> int:
        return self._length


def reason(error: Exception) -> str:
    """One line for a commit record."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
