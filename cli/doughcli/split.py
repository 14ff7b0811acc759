"""`doughdata split`: other splits for the same scenes."""

from typing import Annotated

import typer

from doughcli.copying import IntoOption, copying, report_copy
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption

__all__ = ["command"]

NAME = "split"
HELP = (
    "Copy a dataset and divide its scenes anew into train, val and test. Near-duplicates stay "
    "together. A region decides: the training region is never tested on, nor the other way round."
)
EPILOG = (
    "Examples: [cyan]doughdata split --val 0.1 --into divided[/]  |  "
    "[cyan]doughdata split --test 0.2 --seed 3 --into divided[/]"
)


def command(
    into: IntoOption,
    dataset: DatasetOption = DATASET_DEFAULT,
    test: Annotated[
        float, typer.Option("--test", metavar="SHARE", help="Share of scenes to test on.")
    ] = 0.0,
    val: Annotated[
        float, typer.Option("--val", metavar="SHARE", help="Share of scenes to validate on.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the choice.")] = 0,
    ignore_regions: Annotated[
        bool,
        typer.Option("--ignore-regions", help="Let scenes of every region have any split."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Copy and divide; the same command again goes on after an interruption."""
    from doughdata.dataset.split import SplitPlan, resplit

    plan = SplitPlan(test=test, val=val, seed=seed, ignore_regions=ignore_regions)
    with copying("split") as on_scenes:
        copied = resplit(dataset, into, plan, on_scenes=on_scenes)
    report_copy(copied, as_json=as_json)
