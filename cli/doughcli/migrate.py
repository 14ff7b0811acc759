"""`doughdata migrate`: bring an older dataset forward."""

from typing import Annotated

import typer

from doughcli.copying import copying
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "migrate"
HELP = (
    "Bring a dataset to the newest format version. Committed data are never rewritten; the same "
    "command again goes on after an interruption."
)
EPILOG = (
    "1.0 to 1.1 adds what touches what in every key frame to meta/frames.parquet.  Examples: "
    "[cyan]doughdata migrate --dry-run[/]  |  [cyan]doughdata migrate --dataset s3://bucket/old[/]"
)


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done and stop.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Add what is missing, then raise the version."""
    from dataclasses import asdict

    from doughdata.dataset.migrate import migrate

    with copying("migrate") as on_scenes:
        found = migrate(dataset, dry_run=dry_run, on_scenes=on_scenes)
    if as_json:
        emit_json({**asdict(found), "dry_run": dry_run, "changed": found.changed})
        return
    if not found.changed:
        print(f"{dataset}: format {found.after} is the newest, nothing to do")
        return
    kept = f", {found.kept} were there" if found.kept else ""
    step = f"brought from format {found.before} to {found.after}"
    if found.before == found.after:
        step = f"derived tables brought up to format {found.after}"
    would = "would be " if dry_run else ""
    print(f"{dataset}: {would}{step}, {found.supplements} documents added{kept}")
