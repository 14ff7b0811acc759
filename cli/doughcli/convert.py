"""`doughdata convert`: a recording of a real robot, a cloud or another dataset becomes scenes."""

import inspect
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json
from doughschemas import BadInputError

if TYPE_CHECKING:
    from doughdata.recordings.protocol import Conversion

__all__ = ["command"]

NAME = "convert"
HELP = (
    "Convert a recording (MCAP, .bag, rosbag2, PLY or PCD cloud, the authors' data.h5) to scenes."
)
EPILOG = (
    "Examples: [cyan]doughdata convert run.mcap --expect rolls --color 340-20[/]  |  "
    "[cyan]doughdata convert cut-short.mcap --salvage[/]  |  "
    "[cyan]doughdata convert run.mcap --save-steps steps[/]"
)


def command(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="File or folder.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    expect: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What the first frame must show: rolls, doughnut, ..."),
    ] = None,
    depth_topic: Annotated[str | None, typer.Option(metavar="TOPIC", help="Depth images.")] = None,
    color_topic: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Colour images; none leaves them out.")
    ] = None,
    info_topic: Annotated[str | None, typer.Option(metavar="TOPIC", help="Calibration.")] = None,
    gripper_topic: Annotated[
        str | None,
        typer.Option(metavar="TOPIC[:FIELD]", help="Opening: a joint's name or a field (width)."),
    ] = None,
    gripper_scale: Annotated[
        float | None, typer.Option(metavar="M", help="Metres per unit of the opening.")
    ] = None,
    tool_frame: Annotated[
        str | None, typer.Option(metavar="FRAME", help="tf frame of the gripper.")
    ] = None,
    color: Annotated[
        str | None,
        typer.Option(
            metavar="H-H[,S-S[,V-V]]",
            help="Colour of the dough: hue in degrees (340-20 is red), the others in percent.",
        ),
    ] = None,
    intrinsics: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON: width height fx fy cx cy.")
    ] = None,
    depth_scale: Annotated[
        float | None, typer.Option(metavar="M", help="Metres per unit of 16-bit depth.")
    ] = None,
    height_min: Annotated[
        float | None, typer.Option(metavar="M", help="Dough begins above the table (0.005).")
    ] = None,
    height_max: Annotated[
        float | None, typer.Option(metavar="M", help="Dough ends above the table (0.150).")
    ] = None,
    voxel: Annotated[float | None, typer.Option(metavar="M", help="Voxel size (0.002).")] = None,
    cluster_distance: Annotated[
        float | None, typer.Option(metavar="M", help="Pieces are further apart (0.010).")
    ] = None,
    every: Annotated[int | None, typer.Option(min=1, help="Take every n-th frame.")] = None,
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Take N frames, evenly in time.")
    ] = None,
    salvage: Annotated[
        bool, typer.Option("--salvage", help="Take what can be read of a damaged recording.")
    ] = False,
    save_steps: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for a picture of every step.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="Any other number of the processing."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Convert and say what was lost; exit code 1 if something was, without --salvage."""
    from doughcli.progress_steps import StepBars

    topics = {
        "depth_topic": depth_topic,
        "color_topic": color_topic,
        "info_topic": info_topic,
        "gripper_topic": gripper_topic,
        "gripper_scale": gripper_scale,
        "tool_frame": tool_frame,
        "intrinsics": intrinsics,
        "depth_scale": depth_scale,
        "every": every,
        "frames": frames,
    }
    processing = {
        "color": color,
        "expect": expect,
        "height_min": height_min,
        "height_max": height_max,
        "voxel": voxel,
        "cluster_distance": cluster_distance,
    }
    options = {
        "topics": _topics(_given(topics)),
        "processing": _processing(_given(processing) | _more(option or ())),
        "salvage": salvage or None,
        "save_steps": save_steps,
    }
    name, converter = _converter(recording)
    options = _given(options)
    _check_options(name, converter, options)
    with StepBars(quiet=as_json) as bars:
        done = converter.convert(recording, dataset, on_progress=bars, **options)
    _report(done, recording, as_json=as_json)
    if done.losses and not salvage:
        raise typer.Exit(1)


def _converter(path: Path) -> tuple[str, Any]:
    """The registered converter that takes a file or folder."""
    from doughdata import registry
    from doughdata.recordings.files import check_readable
    from doughschemas import MissingPackageError

    missing: MissingPackageError | None = None
    for name in registry.names("converters"):
        try:
            converter = registry.load("converters", name)()
        except MissingPackageError as error:
            missing = error
            continue
        if converter.takes(path):
            return name, converter
    check_readable(path)
    if missing is not None:
        raise missing
    from doughdata.recordings.errors import RecordingError

    known = ", ".join(registry.names("converters")) or "none"
    raise RecordingError(f"{path} is nothing that a converter takes (there are: {known})")


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """Options that the user gave."""
    return {name: value for name, value in options.items() if value is not None}


def _topics(given: dict[str, Any]) -> Any:
    """The record of these options, None for none."""
    if not given:
        return None
    from doughdata.recordings.calibration import read_intrinsics
    from doughdata.recordings.options import TopicOptions

    if "intrinsics" in given:
        given["intrinsics"] = read_intrinsics(given["intrinsics"])
    return TopicOptions(**given)


def _processing(given: dict[str, Any]) -> Any:
    """The record of these numbers, None for none."""
    if not given:
        return None
    from dataclasses import fields

    from doughdata.recordings.colour import colour_range
    from doughdata.recordings.options import ProcessingConfig

    known = [field.name for field in fields(ProcessingConfig)]
    if wrong := sorted(set(given) - set(known)):
        raise BadInputError(f"--option: no number {wrong[0]!r} (there are: {', '.join(known)})")
    if "color" in given:
        given["color"] = colour_range(given["color"])
    return ProcessingConfig(**given)


def _more(pairs: list[str] | tuple[str, ...]) -> dict[str, Any]:
    """NAME=VALUE of numbers."""
    found: dict[str, Any] = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            value = json.loads(text)
        except ValueError:
            value = None
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise BadInputError(f"--option must be NAME=NUMBER, got {pair!r}")
        found[name] = value
    return found


def _check_options(name: str, converter: Any, options: dict[str, Any]) -> None:
    """Refuse what this converter does not take."""
    parameters = inspect.signature(converter.convert).parameters
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        return
    if wrong := sorted(set(options) - set(parameters)):
        kinds = {"topics": "options about topics", "processing": "options about processing"}
        what = kinds.get(wrong[0], f"--{wrong[0].replace('_', '-')}")
        raise BadInputError(f"converter {name!r} takes no {what}")


def _report(done: "Conversion", recording: Path, *, as_json: bool) -> None:
    from doughdata.recordings.errors import one_line

    if as_json:
        emit_json({"recording": str(recording), **done.to_json()})
        return
    for line in (*done.warnings, *map(str, done.losses)):
        typer.echo(one_line(f"{recording.name}: {line}"), err=True)
    scenes = ", ".join(str(index) for index in done.scenes[:8])
    more = f" and {len(done.scenes) - 8} more" if len(done.scenes) > 8 else ""
    frames = f"{done.frames} key frame" + ("" if done.frames == 1 else "s")
    print(f"{recording.name}: {frames} as scene {scenes}{more} of {done.dataset}")
