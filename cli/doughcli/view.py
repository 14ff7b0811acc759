"""`doughdata view`: a contact sheet of a dataset."""

from pathlib import Path
from typing import Annotated

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "view"
HELP = "Save a contact sheet: particles, mesh, depth, scene graph, c and g per frame."
EPILOG = "Example: [cyan]doughdata view --scene 0 --save sheet.png[/]"


def command(
    save: Annotated[Path, typer.Option("--save", metavar="X.png", help="Where the picture goes.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    scene: Annotated[
        list[int] | None,
        typer.Option(
            "--scene",
            min=0,
            metavar="I",
            help="Scene index; may be given again (default: the first four).",
        ),
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(metavar="SENSOR", help="Depth layer to show (default: the first).")
    ] = None,
) -> None:
    """Draw and print the path."""
    if save.suffix.lower() != ".png":
        raise BadInputError(f"--save must name a .png file, got {save}")
    if not save.parent.is_dir():
        raise BadInputError(f"--save: folder {save.parent} does not exist")
    from doughdata import open_dataset
    from doughdata.view.sheet import save_sheet

    with open_dataset(dataset) as opened:
        save_sheet(opened, save, scenes=scene, sensor=sensor)
    print(save.resolve())
