"""One page with all tables and figures of a trained model, beside those of the paper.

    python scripts/report --weights model-run --dataset model-dataset --out model-report

Everything is measured by the project's own commands; what was measured before, with the same
weights and data, is not measured again. Changes of topology are looked for in all key frames that
were rendered. `--ablations` is what `scripts/ablations.py` left.
"""

import argparse
import hashlib
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from figures import by_step, embedded
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from measured import Measurements
from tables import (
    METHODS,
    Table,
    ablation_table,
    changes_table,
    method_table,
    model_table,
    planning_table,
    sizes_table,
)

from doughdata.dataset import open_dataset
from doughnet.runs import find_weights
from doughnet.weights import TENSORS, load_weights, write_atomically
from doughschemas import DoughError

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TITLES = {"full_sequence": "all steps from the first view", "single_step": "one step at a time"}
ABLATED = (
    "Means over seeds and scenes; after the semicolon the difference from the full recipe on the "
    "same seeds and scenes."
)
UNKNOWN = "unknown"
DOUGHNET = str(Path(sys.executable).with_name("doughnet"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page."""

    title: str
    table: Table | None = None
    lines: list[str] = field(default_factory=list)
    pictures: list[str | None] = field(default_factory=list)  # data URIs; None is left out


def fingerprint(folder: Path) -> str:
    """Of all weights of a run: sha256."""
    files = sorted({*folder.rglob(TENSORS), *folder.parent.glob(f"*/{TENSORS}")})
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def measure(options: argparse.Namespace, weights: Path) -> dict[str, Any]:
    """Run what was not run before; name -> measurement."""
    inputs = [fingerprint(weights), open_dataset(options.dataset).fingerprint]
    kept = Measurements(options.out / "measured", inputs=inputs)
    where = ["--dataset", options.dataset, "--weights", options.weights or str(weights),
             "--split", options.split, "--sensor", options.sensor, "--json"]  # fmt: skip
    commands = {name: [DOUGHNET, "evaluate", *where, "--method", name] for name in METHODS}
    commands["analysis"] = [DOUGHNET, "analyze", *where, "--save", str(options.out / "analysis")]
    plan = [sys.executable, str(ROOT / "benchmarks" / "planning.py")]
    commands["planning"] = [*plan, *where, "--goals", str(options.goals)]
    found = {}
    for name, command in commands.items():
        print(f"report: {name}", file=sys.stderr, flush=True)
        found[name] = kept.get(name, command)
    return found


def ablations(folder: Path | None) -> dict[str, list[Any]]:
    """Recipe -> table of each seed, as `scripts/ablations.py` left them."""
    found: dict[str, list[Any]] = {}
    for path in sorted(folder.glob("*/evaluation.json")) if folder is not None else []:
        recipe = path.parent.name.rpartition("-")[0]
        found.setdefault(recipe, []).append(json.loads(path.read_text(encoding="utf-8")))
    if "full" not in found:
        return {}
    return {"full": found.pop("full"), **found}


def sizes(options: argparse.Namespace, weights: Path, found: dict[str, Any]) -> dict[str, Any]:
    """What this model and its data measure."""
    loaded = load_weights(weights)
    config, provenance = loaded.model.config, loaded.provenance
    scenes = open_dataset(options.dataset).scenes["split"].to_pylist()
    budget = provenance.get("budget", {}).items()  # weights of another loop may not tell
    parameters = sum(value.numel() for value in loaded.model.parameters())
    goals = found["planning"].get("result", {}).get("goals", 0)
    return {
        "latents": f"{config.tokens} x {config.width}",
        "dynamics stacks": config.dynamics_stacks,
        "training scenes": scenes.count("train"),
        "test scenes": scenes.count(options.split),
        "key frames a scene": len(provenance.get("data", {}).get("frames", ())) or UNKNOWN,
        "goals planned for": goals,
        "recorded scenes": 0,
        "preset": provenance.get("preset", UNKNOWN),
        "parameters [million]": round(parameters / 1e6, 1),
        "training of each stage": ", ".join(f"{v:g} {k}" for k, v in budget if v) or UNKNOWN,
        "sensor": options.sensor,
    }


def sections(options: argparse.Namespace, weights: Path) -> list[Section]:
    """All parts of the page, measured."""
    paper = json.loads((HERE / "paper.json").read_text(encoding="utf-8"))
    found = measure(options, weights)
    methods = {name: found[name] for name in METHODS}
    recipes = ablations(options.ablations)
    analysis = options.out / "analysis"
    its = sizes(options, weights, found)
    if recipes:
        its["seeds of an ablation"] = len(recipes["full"])
    parts = [
        Section(
            title="Methods",
            lines=["Predicted from the first view and the tool's motion alone, at 1 mm."],
            table=method_table(methods, paper["methods"]),
            pictures=[by_step(methods)],
        ),
        Section(
            title="The model, row by row",
            lines=["The ceiling is what perfect dynamics would reach with this autoencoder."],
            table=model_table(found["doughnet"]),
        ),
    ]
    for row in ("full_sequence", "single_step") if recipes else ():
        table = ablation_table(recipes, paper["recipes"], row=row)
        parts.append(Section(title=f"Ablations, {TITLES[row]}", lines=[ABLATED], table=table))
    pictures = [embedded(analysis / name) for name in ("roc.png", "precision_recall.png")]
    parts += [
        Section(title="Planning", table=planning_table(found["planning"], paper["planning"])),
        Section(
            title="Changes of topology, from jumps of the latents",
            table=changes_table(found["analysis"], paper["changes"]),
            pictures=pictures,
        ),
        Section(title="Latents", pictures=[embedded(analysis / "tsne.png")]),
        Section(
            title="Errors over a sequence, and what is corrected later",
            pictures=[embedded(analysis / "errors.png")],
        ),
        Section(title="Failures", lines=failures(found["analysis"]),
                pictures=[embedded(analysis / "failures.png")]),
        Section(title="Scales of bodies and tools", pictures=[embedded(analysis / "scales.png")]),
        Section(title="What is smaller here than there", table=sizes_table(its, paper["sizes"])),
    ]  # fmt: skip
    return parts


def failures(analysis: dict[str, Any]) -> list[str]:
    """How often the model contradicts itself."""
    if "error" in analysis:
        return [f"not measured: {analysis['error']}"]
    result = analysis["result"]
    return [
        f"{result['failures']} predicted frames have a wrong topology; masks and genus head "
        f"disagree in {result['inconsistent_percent']} % of all."
    ]


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description="One page about a trained model.")
    parser.add_argument("--weights", help="folder of a training (default: the shipped)")
    parser.add_argument("--dataset", default="model-dataset")
    parser.add_argument("--ablations", type=Path, help="folder of trained ablations")
    parser.add_argument("--split", default="test")
    parser.add_argument("--sensor", default="realsense")
    parser.add_argument("--goals", type=int, default=20, help="held-out scenes to plan for")
    parser.add_argument("--out", type=Path, default=Path("model-report"))
    options = parser.parse_args()
    try:
        weights = find_weights(options.weights)
        parts = sections(options, weights)
    except DoughError as error:
        sys.exit(f"report: {error}")
    kinds = Environment(loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined)
    paper = json.loads((HERE / "paper.json").read_text(encoding="utf-8"))["source"]
    page = kinds.get_template("page.html.j2").render(sections=parts, paper_source=paper)
    write_atomically(options.out / "index.html", page.encode())
    print(options.out / "index.html")


if __name__ == "__main__":
    main()
