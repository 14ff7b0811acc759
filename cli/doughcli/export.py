"""`doughdata export`: scenes of a dataset in another program's format."""

import inspect
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "export"
HELP = "Write scenes in another format, for other programs."
EPILOG = (
    "Examples: [cyan]doughdata export --to glb --scene 0 --frame 60 --out dough.glb[/]  |  "
    "[cyan]doughdata export --to glb --scene 0 --animated --out dough.glb[/]"
)


def command(
    to: Annotated[str, typer.Option("--to", metavar="NAME", help="Format (doughdata plugins).")],
    out: Annotated[Path, typer.Option("--out", metavar="PATH", help="File or folder to write.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    scene: Annotated[
        list[int] | None,
        typer.Option(
            "--scene", min=0, metavar="I", help="Scene index; may be given again (default: all)."
        ),
    ] = None,
    frame: Annotated[
        int | None, typer.Option("--frame", min=0, metavar="K", help="One key frame (glb).")
    ] = None,
    animated: Annotated[
        bool, typer.Option("--animated", help="All key frames as an animation (glb).")
    ] = False,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option", metavar="NAME=VALUE", help="Any other option of the format; repeatable."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Export and print what was written."""
    from doughdata import open_dataset, registry

    exporter = registry.load("exporters", to)()
    options = _options(option or ())
    if frame is not None:
        options["frame"] = frame
    if animated:
        options["animated"] = True
    _check_options(to, exporter, options)
    if not out.parent.is_dir():
        raise BadInputError(f"--out: folder {out.parent} does not exist")
    with open_dataset(dataset) as opened:
        scenes = _scenes(scene or (), opened.scene_indices)
        written = exporter.export(opened, scenes, out, **options)
    if as_json:
        emit_json({"files": [str(path) for path in written], "scenes": scenes})
        return
    for path in written:
        print(path.resolve())


def _scenes(wanted: list[int] | tuple[int, ...], there: list[int]) -> list[int]:
    """Scenes asked for, each once; all that there are by default."""
    if wrong := [index for index in wanted if index not in there]:
        raise BadInputError(f"no scene {wrong[0]}: doughdata info lists what the dataset holds")
    return list(dict.fromkeys(wanted or there))


def _options(pairs: list[str] | tuple[str, ...]) -> dict[str, Any]:
    """NAME=VALUE, the value as JSON where it is some, else as text."""
    options = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not (equals and name.isidentifier()):
            raise BadInputError(f"--option must be NAME=VALUE, got {pair!r}")
        try:
            options[name] = json.loads(value)
        except ValueError:
            options[name] = value
    return options


def _check_options(name: str, exporter: Any, options: dict[str, Any]) -> None:
    """Refuse what the exporter does not take, and name what it does."""
    parameters = inspect.signature(exporter.export).parameters.values()
    known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return
    if wrong := sorted(set(options) - set(known)):
        takes = f"takes: {', '.join(known)}" if known else "takes no options"
        raise BadInputError(f"exporter {name!r} has no option {wrong[0]!r} ({takes})")
