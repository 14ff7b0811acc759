"""Options that several commands share."""

import json
from typing import Annotated, Any

import typer

__all__ = ["DatasetOption", "ExecutorOption", "JsonOption", "WorkersOption", "emit_json"]

DatasetOption = Annotated[
    str,
    typer.Option(
        "--dataset",
        envvar="DOUGHDATA_DATASET",
        metavar="URI",
        help="Folder or URI of the dataset.",
    ),
]
DATASET_DEFAULT = "./dough-dataset"
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
ExecutorOption = Annotated[
    str, typer.Option("--executor", metavar="NAME", help="Where to work: serial, processes or ray.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, metavar="N", help="Worker processes (default: one a core)."),
]


def emit_json(data: Any) -> None:
    """Print one JSON object on one line."""
    print(json.dumps(data, allow_nan=False))
