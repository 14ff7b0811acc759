"""`doughdata merge`: several datasets become one."""

from typing import Annotated

import typer

from doughcli.copying import IntoOption, copying, report_copy
from doughcli.options import JsonOption

__all__ = ["command"]

NAME = "merge"
HELP = "Copy the scenes of several datasets into a new one; scenes are renumbered, splits kept."
EPILOG = (
    "Examples: [cyan]doughdata merge rolls rings --into all[/]  |  "
    "[cyan]doughdata merge monday tuesday --into week --skip-duplicates[/]"
)


def command(
    datasets: Annotated[
        list[str], typer.Argument(metavar="URI URI ...", help="Datasets, in this order.")
    ],
    into: IntoOption,
    mixed: Annotated[
        bool,
        typer.Option("--mixed", help="Allow layers made by different stages or configurations."),
    ] = False,
    skip_duplicates: Annotated[
        bool,
        typer.Option("--skip-duplicates", help="Of scenes with one scene_id take the first."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Merge; the same command again goes on after an interruption."""
    from doughdata.dataset.merge import merge

    with copying("merge") as on_scenes:
        copied = merge(
            datasets, into, mixed=mixed, skip_duplicates=skip_duplicates, on_scenes=on_scenes
        )
    report_copy(copied, as_json=as_json)
