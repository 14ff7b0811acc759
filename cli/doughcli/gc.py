"""`doughdata gc`: free the space of what no reader can reach any more."""

from typing import Annotated

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "gc"
HELP = "Remove leftovers of interrupted runs and data that a newer revision replaced."
EPILOG = "Examples: [cyan]doughdata gc --dry-run[/]  |  [cyan]doughdata gc --grace 1[/]"


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    grace: Annotated[
        float,
        typer.Option(min=0.0, metavar="HOURS", help="Keep what is younger than this."),
    ] = 24.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be removed and stop.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Committed data and commit records are never touched."""
    from dataclasses import asdict

    from doughdata.dataset.collect import collect

    found = collect(dataset, grace=grace * 3600.0, dry_run=dry_run)
    if as_json:
        emit_json({"dataset": dataset, "dry_run": dry_run, **asdict(found)})
        return
    for path in (*found.orphans, *found.superseded, *found.temporary):
        print(path)
    print(
        f"{dataset}: {'would remove' if dry_run else 'removed'} {len(found.orphans)} orphans, "
        f"{len(found.superseded)} superseded, {len(found.temporary)} temporary; "
        f"{found.young} younger than {grace:g} hours kept"
    )
