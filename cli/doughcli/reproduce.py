"""`doughdata reproduce`: make a scene again and compare."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

if TYPE_CHECKING:
    from doughdata.dataset import Dataset

__all__ = ["command"]

NAME = "reproduce"
HELP = "Make a scene again with the recorded settings and compare the hashes of every layer."
EPILOG = "Example: [cyan]doughdata reproduce --scene 3[/]"


def command(
    scene: Annotated[int, typer.Option("--scene", min=0, metavar="I", help="Index of the scene.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    stages: Annotated[
        str | None,
        typer.Option(metavar="LAYER[,LAYER]", help="Layers to compare (default: all it has)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Each layer is made again from the stored ones before it; exit code 1 if one differs."""
    from doughdata import open_dataset
    from doughdata.reproduce import reproduce

    opened = open_dataset(dataset)
    found = {}
    for result in reproduce(opened, scene, recorded_stages(opened, scene, stages)):
        found[result.layer] = {
            "equal": result.equal,
            "stored": result.stored,
            "again": result.again,
            "difference": result.difference,
        }
        if not as_json:
            print(f"  {result.layer}: {'equal' if result.equal else result.difference}", flush=True)
    equal = all(layer["equal"] for layer in found.values())
    if as_json:
        emit_json({"dataset": dataset, "scene": scene, "equal": equal, "layers": found})
    if not equal:
        raise typer.Exit(1)


def recorded_stages(dataset: "Dataset", scene: int, layers: str | None) -> dict[str, Any]:
    """Layer -> the stage that made it."""
    from doughcli.rebuild import rebuild_depth, rebuild_stage
    from doughschemas import MissingLayerError

    wanted = dataset.layers if layers is None else [part.strip() for part in layers.split(",")]
    stages = {}
    for layer in wanted:
        try:
            record = dataset.layer(layer, scene).commit.stage
        except MissingLayerError:
            if layers is None and layer != "sim":  # not made for this scene, which is no difference
                continue
            raise
        depth = layer.startswith("depth.")
        stages[layer] = rebuild_depth(record) if depth else rebuild_stage(layer, record)
    return stages
