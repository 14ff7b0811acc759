"""`doughdata subset`: some scenes become a dataset of their own."""

from typing import Annotated

import typer

from doughcli.copying import IntoOption, copying, report_copy
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption

__all__ = ["command"]

NAME = "subset"
HELP = "Copy some scenes into a new dataset; a scene must satisfy every option that is given."
EPILOG = (
    "Examples: [cyan]doughdata subset --scenes 0,4-9 --into few[/]  |  "
    "[cyan]doughdata subset --family rolls --final c=3 --final c=4 --into cut[/]  |  "
    "[cyan]doughdata subset --split test --event merge --into merges[/]"
)
Texts = list[str] | None


def command(
    into: IntoOption,
    dataset: DatasetOption = DATASET_DEFAULT,
    scenes: Annotated[
        str | None, typer.Option("--scenes", metavar="0,4-9", help="Scene indices.")
    ] = None,
    family: Annotated[
        Texts, typer.Option("--family", metavar="NAME", help="Scene family; repeatable.")
    ] = None,
    split: Annotated[
        Texts, typer.Option("--split", metavar="NAME", help="Split; repeatable.")
    ] = None,
    region: Annotated[
        Texts, typer.Option("--region", metavar="NAME", help="Region; repeatable.")
    ] = None,
    final: Annotated[
        Texts,
        typer.Option(
            "--final",
            metavar="LABEL",
            help='How a scene ends, as `doughdata stats` says it: "c=2 g=0,1" or c=2; repeatable.',
        ),
    ] = None,
    event: Annotated[
        Texts,
        typer.Option(
            "--event",
            metavar="KIND",
            help="What happens: merge, split, self_merge or self_split; repeatable.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Copy scenes; the same command again goes on after an interruption."""
    from doughdata.dataset.selection import SceneFilter, parse_indices
    from doughdata.dataset.subset import subset

    wanted = SceneFilter(
        scenes=parse_indices(scenes) if scenes is not None else (),
        families=tuple(family or ()),
        splits=tuple(split or ()),
        regions=tuple(region or ()),
        final=tuple(final or ()),
        events=tuple(event or ()),
    )
    with copying("subset") as on_scenes:
        copied = subset(dataset, into, wanted, on_scenes=on_scenes)
    report_copy(copied, as_json=as_json)
