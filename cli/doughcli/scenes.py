"""`doughdata scenes`: look at scene families, print scenes as JSON."""

import json
from typing import Annotated

import typer

from doughcli.options import JsonOption, emit_json

__all__ = ["app"]

app = typer.Typer(
    help="List scene families; print a scene as JSON.",
    epilog="Example: doughdata scenes show rolls --seed 3 > mine.json",
    no_args_is_help=True,
)


@app.command("list", epilog="Example: doughdata scenes list")
def list_families(as_json: JsonOption = False) -> None:
    """List the scene families that `generate --scenes` knows."""
    from doughdata import registry

    families = registry.names("scenes")
    about = {
        name: (registry.load("scenes", name).__doc__ or "").splitlines()[0] for name in families
    }
    if as_json:
        emit_json(about)
        return
    for name, line in about.items():
        print(f"{name:<12}{line}")


@app.command("show", epilog="Example: doughdata scenes show rolls --seed 3 > mine.json")
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Scene family, or mesh:FILE.")],
    seed: Annotated[int, typer.Option(min=0, help="Root seed.")] = 0,
    number: Annotated[int, typer.Option(min=0, help="Scene number within its split.")] = 0,
    split: Annotated[str, typer.Option(help="train or test.")] = "train",
    material: Annotated[
        str | None, typer.Option(metavar="NAME", help="play-doh, dough, clay, or sampled.")
    ] = None,
) -> None:
    """Print one scene as JSON; edit it and run it with `generate --scenes FILE.json`."""
    from doughcli.build import sample_one
    from doughdata.requests import FamilyScenes
    from doughdata.scenes import scene_to_json

    wanted = FamilyScenes(family=name, count=number + 1, seed=seed, split=split, material=material)
    scene = sample_one(wanted, split=split, number=number)
    print(json.dumps(scene_to_json(scene), indent=2))
