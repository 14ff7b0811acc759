"""`doughdata validate`: is a dataset whole and unchanged?"""

from typing import Annotated

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "validate"
HELP = "Check structure, versions and hashes; with --deep every chunk, mesh, graph and pose."
EPILOG = "Examples: [cyan]doughdata validate --deep[/]  |  [cyan]doughdata validate --json[/]"
MOST = 20  # problems that are printed


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    deep: Annotated[bool, typer.Option("--deep", help="Read everything.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Exit code 1 if a problem was found."""
    from dataclasses import asdict

    from doughdata.dataset.validate import validate

    found = validate(dataset, deep=deep)
    if as_json:
        emit_json({"dataset": dataset, "ok": not found.problems, **asdict(found)})
    else:
        for problem in found.problems[:MOST]:
            print(problem)
        if len(found.problems) > MOST:
            print(f"... and {len(found.problems) - MOST} more")
        figures = ", ".join(
            f"{key.replace('_', ' ')} {f'{value:.3g}' if isinstance(value, float) else value}"
            for key, value in found.figures.items()
            if value is not None
        )
        print(f"{dataset}: {len(found.problems) or 'no'} problems; {figures}")
    if found.problems:
        raise typer.Exit(1)
