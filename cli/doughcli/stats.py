"""`doughdata stats`: which topologies a dataset ends with, and where the static check differs."""

from collections import Counter, defaultdict
from typing import Any

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "stats"
HELP = "Count final topologies, events and ambiguous frames per family; compare the static check."
EPILOG = "Example: [cyan]doughdata stats --json[/]"


def command(dataset: DatasetOption = DATASET_DEFAULT, as_json: JsonOption = False) -> None:
    """Print the counts."""
    from doughdata import open_dataset

    found = {"dataset": dataset, "families": topology_stats(open_dataset(dataset))}
    if as_json:
        emit_json(found)
        return
    for family, stats in found["families"].items():
        print(f"{family}: {stats['scenes']} scenes, {stats['changed']} change topology")
        for name, count in stats["final"].items():
            print(f"    ends as {name}: {count}")
        print(f"    events: {', '.join(f'{k} {n}' for k, n in stats['events'].items()) or 'none'}")
        print(f"    ambiguous frames: {stats['ambiguous']:.1%}")
        print(f"    frames where the static check differs: {stats['static_differs']:.1%}")


def topology_stats(dataset: Any) -> dict[str, dict[str, Any]]:
    """Per family: scenes, how they end, events, shares of ambiguous and of differing frames."""
    family = dict(
        zip(
            dataset.scenes["scene_index"].to_pylist(),
            dataset.scenes["family"].to_pylist(),
            strict=True,
        )
    )
    frames: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in dataset.frames.to_pylist():
        if row["num_components"] is not None:
            frames[family[row["scene_index"]]].append(row)
    events: dict[str, Counter[str]] = defaultdict(Counter)
    for event in dataset.table("topology_events").to_pylist():
        events[family[event["scene_index"]]][event["kind"]] += 1
    return {name: _family(rows, events[name]) for name, rows in sorted(frames.items())}


def _family(rows: list[dict[str, Any]], events: Counter[str]) -> dict[str, Any]:
    scenes: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        scenes[row["scene_index"]].append(row)
    first = {i: min(r, key=lambda row: row["frame_index"]) for i, r in scenes.items()}
    last = {i: max(r, key=lambda row: row["frame_index"]) for i, r in scenes.items()}
    final = Counter(_name(row) for row in last.values())
    differs = sum(_name(row) != _name(row, "static_") for row in rows)
    return {
        "scenes": len(scenes),
        "changed": sum(_name(first[i]) != _name(last[i]) for i in scenes),
        "final": dict(final.most_common()),
        "events": dict(events.most_common()),
        "ambiguous": sum(bool(row["ambiguous"]) for row in rows) / len(rows),
        "static_differs": differs / len(rows),
    }


def _name(row: dict[str, Any], prefix: str = "") -> str:
    """`c=2 g=0,1`: components, and the genus of each, sorted."""
    genus = sorted(row[f"{prefix}genus"] or [])
    return f"c={row[f'{prefix}num_components']} g={','.join(map(str, genus))}"
