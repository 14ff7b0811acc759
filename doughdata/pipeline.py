"""READ FIRST: the stages composed. scenes -> simulate -> check topology -> mesh -> render.

Every stage is a map over shards: list what is not committed yet, let an executor work on it and
commit. Stopping anywhere loses at most the shards in work; the same call goes on from there.
"""

from collections.abc import Mapping, Sequence

from doughdata.dataset import DatasetSettings, DatasetWriter, Shard, open_dataset, open_writer
from doughdata.render.depth import DepthStage
from doughdata.requests import FamilyScenes, Listener, Silent, Stages, Summary
from doughdata.shard_run import over_shards
from doughdata.shard_tasks import RenderShard, ShardStage, config_of, stage_record
from doughdata.stages import Executor, Sensor
from doughschemas import MissingLayerError, Scene

__all__ = ["generate", "plan", "render"]


def generate(
    uri: str,
    wanted: Sequence[FamilyScenes | Scene],
    stages: Stages,
    executor: Executor,
    *,
    settings: DatasetSettings,
    retry_failed: bool = False,
    listener: Listener | None = None,
) -> Summary:
    """Make scenes into a dataset: simulate them, check their topology, mesh them.

    Raises:
        DatasetError: the folder holds something else, or was made with another configuration.
    """
    writer = open_writer(uri, settings)
    records = {k: stage_record(kind, stage) for k, (kind, stage) in stages.by_layer().items()}
    for layer, record in records.items():
        writer.check_stage(layer, record)
    shards = plan(writer, wanted)
    summary = Summary(dataset=uri)
    with executor:
        for layer, (_, stage) in stages.by_layer().items():
            work = ShardStage(writer=writer, layer=layer, stage=stage, record=records[layer])
            summary = over_shards(
                work,
                {layer: records[layer]},
                shards,
                executor,
                retry_failed=retry_failed,
                listener=listener or Silent(),
                summary=summary,
            )
    writer.refresh()
    return summary


def render(
    uri: str,
    stage: DepthStage,
    sensors: Mapping[str, Sensor],
    executor: Executor,
    *,
    retry_failed: bool = False,
    listener: Listener | None = None,
) -> Summary:
    """Render depth of every meshed scene: each ideal image once, one layer a sensor.

    Raises:
        DatasetError: no dataset, no meshes, or layers made with another configuration.
    """
    writer = open_writer(uri)
    if "mesh" not in open_dataset(uri).layers:
        raise MissingLayerError(
            f"{uri} has no meshes yet: doughdata generate --stages topology,mesh"
        )
    records = {
        f"depth.{name}": stage_record("sensors", sensor, render=config_of(stage))
        for name, sensor in sensors.items()
    }
    for layer, record in records.items():
        writer.check_stage(layer, record)
    work = RenderShard(writer=writer, stage=stage, sensors=sensors, records=records)
    with executor:
        summary = over_shards(
            work,
            records,
            writer.shards(),
            executor,
            retry_failed=retry_failed,
            listener=listener or Silent(),
            summary=Summary(dataset=uri),
        )
    writer.refresh()
    return summary


def plan(writer: DatasetWriter, wanted: Sequence[FamilyScenes | Scene]) -> list[Shard]:
    """Allocate scenes to shards; scenes that are planned already keep their place."""
    shards: list[Shard] = []
    for entry in wanted:
        if isinstance(entry, FamilyScenes):
            shards += writer.plan_family(
                entry.source, split=entry.split, seed=entry.seed, count=entry.count
            )
    written = [entry for entry in wanted if isinstance(entry, Scene)]
    return shards + (writer.plan_scenes(written) if written else [])
