"""`doughdata view`: a contact sheet, a page of one scene, or a server for a whole dataset."""

from pathlib import Path
from typing import Annotated, Any

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "view"
HELP = (
    "Look at a dataset: a contact sheet (.png), a page of one scene in 3D that opens offline "
    "(.html), or --serve for all scenes in the browser."
)
EPILOG = (
    "Examples: [cyan]doughdata view --scene 0 --save scene.html[/], [cyan]doughdata view --serve[/]"
)
PORT = 8080
Port = Annotated[
    int, typer.Option("--port", min=1, max=65535, metavar="N", help="Port of --serve.")
]
Host = Annotated[
    str, typer.Option("--host", metavar="NAME", help="Address of --serve; 0.0.0.0 for the network.")
]


def command(
    save: Annotated[
        Path | None,
        typer.Option(
            "--save", metavar="X.png|X.html", help="Where the contact sheet or the page goes."
        ),
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve all scenes to a browser on this machine.")
    ] = False,
    dataset: DatasetOption = DATASET_DEFAULT,
    scene: Annotated[
        list[int] | None,
        typer.Option(
            "--scene",
            min=0,
            metavar="I",
            help="Scene index; for a sheet it may be given again (default: four, or the first).",
        ),
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(metavar="SENSOR", help="Depth layer to show (default: the first).")
    ] = None,
    port: Port = PORT,
    host: Host = "127.0.0.1",
) -> None:
    """Draw and print the path, or serve and print the address."""
    if serve == (save is not None):
        raise BadInputError("give either --save X.png, --save X.html or --serve")
    one = save is None or save.suffix.lower() == ".html"
    if one and scene and len(scene) > 1:
        raise BadInputError(
            f"a page shows one scene at a time, got --scene {len(scene)} times: "
            "give it once, or save a .png"
        )
    if save is not None:
        _check_target(save)
    from doughdata import open_dataset

    with open_dataset(dataset) as opened:
        if save is None:
            _serve(opened, scene=scene[0] if scene else None, sensor=sensor, host=host, port=port)
        elif one:
            from doughdata.view.html import save_page

            save_page(opened, save, scene=scene[0] if scene else None, sensor=sensor)
        else:
            from doughdata.view.sheet import save_sheet

            save_sheet(opened, save, scenes=scene, sensor=sensor)
    if save is not None:
        print(save.resolve())


def _check_target(save: Path) -> None:
    if save.suffix.lower() not in (".png", ".html"):
        raise BadInputError(f"--save must name a .png or .html file, got {save}")
    if not save.parent.is_dir():
        raise BadInputError(f"--save: folder {save.parent} does not exist")


def _serve(dataset: Any, *, host: str, port: int, **options: Any) -> None:
    """Serve until Ctrl-C, which is the usual end and no error."""
    from doughdata.view.serve import DatasetServer

    server = DatasetServer(dataset, host=host, port=port, **options)
    moved = "" if server.url.endswith(f":{port}") else f" (port {port} was in use)"
    print(f"{server.url}{moved}  Ctrl-C stops", flush=True)
    try:
        server.run()
    except KeyboardInterrupt:
        server.stop()
        print("\nstopped", flush=True)
    finally:
        server.stop()
