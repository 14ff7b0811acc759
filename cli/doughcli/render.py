"""`doughdata render`: noisy depth images of a dataset's meshes."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from doughcli.generate import report
from doughcli.options import (
    DATASET_DEFAULT,
    DatasetOption,
    ExecutorOption,
    JsonOption,
    WorkersOption,
)

__all__ = ["command"]

NAME = "render"
HELP = "Render depth images of every meshed scene, one layer per sensor."
EPILOG = (
    "Examples: [cyan]doughdata render --noise realsense[/]  |  "
    "[cyan]doughdata render --noise blenderproc --noise none --views 4[/]  |  "
    "[cyan]doughdata render --noise realsense --camera camera.json --all-frames[/]"
)


def command(
    noise: Annotated[
        list[str], typer.Option("--noise", metavar="SENSOR", help="Sensor; may be given again.")
    ],
    dataset: DatasetOption = DATASET_DEFAULT,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Camera as JSON (default: the paper's).")
    ] = None,
    views: Annotated[int, typer.Option(min=1, max=100, metavar="N", help="Views per frame.")] = 1,
    all_frames: Annotated[
        bool, typer.Option("--all-frames", help="Every key frame, not the 13 training frames.")
    ] = False,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try scenes again that failed before.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Render; what is committed already is kept."""
    from doughcli.build import build_executor, build_sensors

    sensors = build_sensors(tuple(dict.fromkeys(noise)))

    from doughcli.progress import StageBars
    from doughdata import open_dataset, pipeline
    from doughdata.render.cameras import read_camera
    from doughdata.render.depth import DepthStage, RenderConfig

    config = RenderConfig(views=views)
    if camera is not None:
        config = replace(config, camera=read_camera(camera))
    if all_frames:
        config = replace(config, frames=None)
    work = build_executor(executor, workers, items=len(open_dataset(dataset)))
    with StageBars() as bars:
        summary = pipeline.render(
            dataset, DepthStage(config), sensors, work, retry_failed=retry_failed, listener=bars
        )
    report(summary, as_json=as_json)
