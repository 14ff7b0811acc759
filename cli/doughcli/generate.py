"""`doughdata generate`: scenes -> simulation -> topology -> meshes, into a dataset."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from doughcli.options import (
    DATASET_DEFAULT,
    DatasetOption,
    ExecutorOption,
    JsonOption,
    WorkersOption,
    emit_json,
)

if TYPE_CHECKING:
    from doughdata.requests import Summary

__all__ = ["command", "report"]

NAME = "generate"
HELP = "Make scenes, simulate them, check their topology and mesh them."
EPILOG = (
    "Examples: [cyan]doughdata generate --scenes rolls,doughnut --num-scenes 20[/]  |  "
    "[cyan]doughdata generate --scenes mine.json --dataset mine[/]  |  "
    "[cyan]doughdata generate --scenes rolls --split test --dry-run[/]"
)


def command(
    scenes: Annotated[
        str,
        typer.Option(
            "--scenes",
            metavar="NAME[,NAME]|FILE.json",
            help="Scene families (mesh:FILE for any closed mesh), or your own scenes.",
        ),
    ],
    num_scenes: Annotated[int, typer.Option(min=1, metavar="N", help="Scenes per family.")] = 8,
    material: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="play-doh, dough, clay, or sampled (one a scene)."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Root seed.")] = 0,
    dataset: DatasetOption = DATASET_DEFAULT,
    frames: Annotated[int, typer.Option(min=2, max=1000, help="Key frames per scene.")] = 75,
    split: Annotated[str, typer.Option(help="train or test; decides the region.")] = "train",
    preset: Annotated[
        str, typer.Option(help="Resolution: draft (2 mm), standard (1.5 mm), fine (1 mm).")
    ] = "draft",
    arch: Annotated[str, typer.Option(help="auto, cpu, cuda or vulkan.")] = "auto",
    stages: Annotated[
        str, typer.Option(metavar="NAME[,NAME]", help="Stages to run.")
    ] = "simulate,topology,mesh",
    mesher: Annotated[str, typer.Option(help="Mesher plug-in.")] = "dual-contouring",
    noise: Annotated[
        str | None, typer.Option(metavar="SENSOR", help="Render with this sensor as well.")
    ] = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scenes_per_shard: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Fixed when the dataset is made; default 1, 8 or 32."
        ),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try scenes again that failed before.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done and stop.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the stages; what is committed already is kept."""
    from doughcli.build import build_executor, build_sensors, build_stages, wanted_scenes

    wanted = wanted_scenes(scenes, count=num_scenes, seed=seed, split=split, material=material)
    names = tuple(part.strip() for part in stages.split(",") if part.strip())
    chosen = build_stages(names, preset=preset, frames=frames, arch=arch, mesher=mesher)
    sensors = build_sensors((noise,) if noise else ())
    total = sum(getattr(entry, "count", 1) for entry in wanted)
    work = build_executor(executor, workers, items=total)
    if dry_run:
        preview(dataset, wanted, names, chosen.by_layer(), as_json=as_json)
        return

    from doughcli.progress import StageBars
    from doughdata import pipeline
    from doughdata.dataset import DatasetSettings
    from doughdata.render.depth import DepthStage

    with StageBars() as bars:
        summary = pipeline.generate(
            dataset,
            wanted,
            chosen,
            work,
            settings=DatasetSettings(
                num_frames=frames,
                scenes_per_shard=scenes_per_shard or shard_size(dataset, total),
            ),
            retry_failed=retry_failed,
            listener=bars,
        )
        if sensors:
            summary = summary.joined(
                pipeline.render(
                    dataset,
                    DepthStage(),
                    sensors,
                    work,
                    retry_failed=retry_failed,
                    listener=bars,
                )
            )
    report(summary, as_json=as_json)


def preview(
    dataset: str, wanted: list, stages: tuple[str, ...], layers: Iterable[str], *, as_json: bool
) -> None:
    """Say what a run would make, layer by layer; nothing is written."""
    ids = scene_ids(wanted)
    made = scenes_made(dataset) if dataset_exists(dataset) else {}
    left = {layer: sum(name not in made.get(layer, ()) for name in ids) for layer in layers}
    there = sum(all(name in made.get(layer, ()) for layer in left) for name in ids)
    found = {
        "dataset": dataset,
        "scenes": len(ids),
        "there": there,
        "left": left,
        "stages": list(stages),
    }
    if as_json:
        emit_json(found)
        return
    each = ", ".join(f"{layer} {count}" for layer, count in left.items())
    print(
        f"would make {len(ids) - there} of {len(ids)} scenes ({there} are there) in {dataset}: "
        f"{each}"
    )


def scenes_made(dataset: str) -> dict[str, set[str]]:
    """Layer -> ids of the scenes that it holds, or that failed."""
    from doughdata import open_dataset
    from doughdata.dataset.commits import CommitLog
    from doughdata.dataset.store import store_of

    log, table = CommitLog(store_of(dataset)), open_dataset(dataset).scenes
    names = dict(zip(table["scene_index"].to_pylist(), table["scene_id"].to_pylist(), strict=True))
    made: dict[str, set[str]] = {}
    for shard in log.shards:
        for layer, commit in log.fresh(shard).items():
            made.setdefault(layer, set()).update(
                names[k] for k in {*commit.scenes, *commit.failed} if k in names
            )
    return made


def dataset_exists(uri: str) -> bool:
    """Whether a dataset was made there."""
    from doughdata.dataset.store import store_of

    return store_of(uri).exists("meta/info.json")


def shard_size(uri: str, total: int) -> int | None:
    """Scenes per shard of a new dataset; None for one that is there, which has its own."""
    from doughdata.dataset import default_scenes_per_shard

    return None if dataset_exists(uri) else default_scenes_per_shard(total)


def scene_ids(wanted: list) -> list[str]:
    """Ids of everything that is asked for."""
    from doughdata.scenes import load_family
    from doughschemas import Scene

    ids = [entry.scene_id for entry in wanted if isinstance(entry, Scene)]
    for entry in wanted:
        if not isinstance(entry, Scene):
            family = load_family(entry.source)
            ids += [
                family.sample(seed=entry.seed, number=k, split=entry.split).scene_id
                for k in range(entry.count)
            ]
    return ids


def report(summary: "Summary", *, as_json: bool) -> None:
    """Print what was done; exit code 1 if scenes failed."""
    if as_json:
        emit_json(summary.as_dict())
    else:
        print(summary.as_text())
    if summary.failed:
        raise typer.Exit(1)
