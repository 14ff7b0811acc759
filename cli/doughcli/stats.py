"""`doughdata stats`: which topologies a dataset ends with, and ranges of its features."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "stats"
HELP = (
    "Count final topologies, events and ambiguous frames per family; compare the static check; "
    "give ranges of features."
)
EPILOG = (
    "Examples: [cyan]doughdata stats --json[/]  |  "
    "[cyan]doughdata stats --arrays[/] (reads everything, keeps it in meta/stats.json)"
)


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    arrays: Annotated[
        bool,
        typer.Option(
            "--arrays", help="Measure particles and depth, too, and write meta/stats.json."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the counts and ranges."""
    from doughdata.dataset.measure import dataset_statistics, measure_arrays
    from doughdata.dataset.store import store_of
    from doughdata.dataset.tables import refresh_tables

    if arrays:
        refresh_tables(store_of(dataset), arrays=measure_arrays(dataset))
    found = {"dataset": dataset, **dataset_statistics(dataset)}
    if as_json:
        emit_json(found)
        return
    print_sizes(found["sizes"])
    for family, stats in found["families"].items():
        print_family(family, stats)
    for name, feature in found["features"].items():
        mean = ", ".join(f"{value:.4g}" for value in feature["mean"])
        low, high = min(feature["min"]), max(feature["max"])
        print(f"{name}: {low:.4g} to {high:.4g}, mean {mean}, of {feature['count'][0]}")


def print_sizes(sizes: Mapping[str, Any]) -> None:
    """One line of totals."""
    views = "".join(f", {count} views of {layer}" for layer, count in sizes["views"].items())
    failed = f", {sizes['failed']} failures" if sizes["failed"] else ""
    print(f"{sizes['scenes']} scenes, {sizes['frames']} key frames{views}{failed}")


def print_family(family: str, stats: Mapping[str, Any]) -> None:
    """How scenes of a family end, what happens in them, and how sure that is."""
    print(f"{family}: {stats['scenes']} scenes, {stats['changed']} change topology")
    for name, count in stats["final"].items():
        print(f"    ends as {name}: {count} ({stats['final_share'][name]:.1%})")
    print(f"    events: {', '.join(f'{k} {n}' for k, n in stats['events'].items()) or 'none'}")
    print(
        f"    ambiguous frames: {stats['ambiguous']:.1%}, final ones {stats['ambiguous_final']:.1%}"
    )
    print(
        f"    frames where the static check differs: {stats['static_differs']:.1%}, "
        f"final ones {stats['static_differs_final']:.1%}"
    )
