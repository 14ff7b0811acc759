"""`doughdata card`: what describes a dataset to others."""

from typing import Annotated

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "card"
HELP = (
    "Write README.md (a Hugging Face dataset card), croissant.json and meta/stats.json again. "
    "What you wrote into the card outside the marks stays."
)
EPILOG = "Example: [cyan]doughdata card --license cc-by-4.0[/]"


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    license_name: Annotated[
        str | None,
        typer.Option(
            "--license", metavar="NAME", help="License of the data (default: what the card says)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write and name the files."""
    from doughdata.dataset.store import store_of
    from doughdata.dataset.tables import refresh_tables

    written = refresh_tables(store_of(dataset), license_name=license_name)["documents"]
    if as_json:
        emit_json({"dataset": dataset, "files": written})
        return
    for name in written:
        print(f"{dataset.rstrip('/')}/{name}")
