"""What a training of `make bench-model` came to: `table.json`, `curve.png` and a model card.

With `--ship`, the weights also go into the package, in bfloat16, with the card beside them: then
`doughnet predict` works without `--weights`.
"""

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from doughdata.registry import require_package
from doughnet.runs import MODEL_STAGES, PRETRAINED, SHIPPED, find_weights
from doughnet.weights import TENSORS, load_weights, save_weights

ROWS = ("reconstruction", "ceiling", "single_step", "full_sequence", "final", "copy_first_frame")
COLUMNS = ("viou", "ciou", "accc", "accg", "balanced_accg")


def evaluated(run: Path, dataset: str, split: str, sensor: str) -> dict[str, Any]:
    """The table of the run's weights; kept beside them."""
    command = [str(Path(sys.executable).with_name("doughnet")), "evaluate", "--json"]
    where = ["--weights", str(run), "--dataset", dataset, "--split", split, "--sensor", sensor]
    done = subprocess.run([*command, *where], check=True, stdout=subprocess.PIPE, text=True)
    (run / "table.json").write_text(done.stdout, encoding="utf-8")
    return json.loads(done.stdout)


def draw_curves(run: Path) -> dict[str, dict[str, float]]:
    """Losses over steps of both stages as a picture; returns the last row of each."""
    require_package("matplotlib", extra="view").use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(MODEL_STAGES), figsize=(10, 4), layout="constrained")
    last = {}
    for axis, stage in zip(axes, MODEL_STAGES, strict=True):
        with (run / stage / "metrics.csv").open(newline="") as file:
            rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
        for name in sorted(rows[0].keys() - {"step", "learning_rate"}):
            axis.plot([row["step"] for row in rows], [row[name] for row in rows], label=name, lw=1)
        axis.set(title=stage, xlabel="step", yscale="log")
        axis.legend()
        last[stage] = rows[-1]
    figure.savefig(run / "curve.png", dpi=110)
    return last


def card(table: dict[str, Any], provenance: dict[str, Any], command: str) -> str:
    """The model card: data, command, table."""
    data = provenance["data"]
    budget = ", ".join(f"{v:g} {k}" for k, v in provenance["budget"].items() if v is not None)
    head = f"| percent | {' | '.join(COLUMNS)} |\n{'|---' * (1 + len(COLUMNS))}|\n"
    rows = [(name, table[name]) for name in ROWS if name in table]
    rows += [(f"{name}, no labels given", row) for name, row in table["unlabelled"].items()]
    body = "".join(
        f"| {name} | " + " | ".join(f"{row[c]:.1f}" for c in COLUMNS) + " |\n" for name, row in rows
    )
    return (
        f"# DoughNet, preset `{provenance['preset']}`\n\n"
        f"Trained on split `{data['split']}` of the dataset with fingerprint "
        f"`{data['fingerprint']}` ({data['samples']} samples of the last stage, sensor "
        f"`{data['sensor']}`), {budget} a stage:\n\n    {command}\n\n"
        f"{table['scenes']} held-out scenes, per frame at 1 mm, mean over frames:\n\n{head}{body}\n"
        f"Final frame, copy of the first: VIoU {table['copy_first_frame']['final_viou']:.1f}. "
        f"Frames in which masks and genus head disagree: {table['inconsistent']}.\n\n"
        "![losses over steps](curve.png)\n"
    )


def main() -> None:
    """Write what came out, print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, default=Path("model-run"))
    parser.add_argument("--dataset", default="model-dataset")
    parser.add_argument("--split", default="test")
    parser.add_argument("--ship", action="store_true", help="copy the weights into the package")
    options = parser.parse_args()
    loaded = load_weights(find_weights(options.run))
    provenance = dict(loaded.provenance)
    preset, minutes = provenance["preset"], provenance["budget"]["minutes"]
    sensor = provenance["data"]["sensor"]
    table = evaluated(options.run, options.dataset, options.split, sensor)
    curves = draw_curves(options.run)
    command = f"make bench-model MODEL_PRESET={preset}"
    command += "" if minutes is None else f" MODEL_MINUTES={minutes:g}"
    text = card(table, provenance, command)
    (options.run / "README.md").write_text(text, encoding="utf-8")
    if options.ship:
        if preset not in SHIPPED:
            sys.exit(f"preset {preset} does not ship, only {', '.join(SHIPPED)} do")
        folder = PRETRAINED / preset
        from torch import bfloat16

        save_weights(loaded.model, folder, provenance=provenance, dtype=bfloat16)
        (folder / "README.md").write_text(text, encoding="utf-8")
        (folder / "curve.png").write_bytes((options.run / "curve.png").read_bytes())
        print(f"{folder}: {(folder / TENSORS).stat().st_size / 1e6:.1f} MB", file=sys.stderr)
    print(json.dumps({"losses": curves, "table": table}))


if __name__ == "__main__":
    main()
