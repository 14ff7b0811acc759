"""`doughdata info`: what a dataset holds."""

from collections import Counter

from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "info"
HELP = "Say what a dataset holds: scenes per family and split, key frames, layers, fingerprint."
EPILOG = "Example: [cyan]doughdata info --json[/]"


def command(dataset: DatasetOption = DATASET_DEFAULT, as_json: JsonOption = False) -> None:
    """Print a summary."""
    from doughdata import open_dataset

    opened = open_dataset(dataset)
    scenes = opened.scenes
    kinds = Counter(zip(scenes["family"].to_pylist(), scenes["split"].to_pylist(), strict=True))
    found = {
        "dataset": dataset,
        "schema_version": opened.info["schema_version"],
        "scenes": len(opened),
        "num_frames": opened.num_frames,
        "families": {
            f"{family}/{split}": count for (family, split), count in sorted(kinds.items())
        },
        "layers": list(opened.layers),
        "fingerprint": opened.fingerprint,
    }
    if as_json:
        emit_json(found)
        return
    print(f"dataset {dataset} (format {found['schema_version']})")
    print(f"  {found['scenes']} scenes of {found['num_frames']} key frames")
    for kind, count in found["families"].items():
        print(f"    {kind}: {count}")
    print(f"  layers: {', '.join(found['layers']) or 'none'}")
    print(f"  fingerprint: {found['fingerprint']}")
