"""Train and score the ablations: every recipe from every seed, one folder each.

    python scripts/ablations.py --dataset model-dataset --preset micro --seeds 3 --minutes 20

OUT/RECIPE-SEED holds the stages and `evaluation.json`, the table of the test split. Recipes that
change the dynamics alone share their seed's autoencoder. Stopped at any moment, the same command
goes on.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from doughnet.recipes import RECIPES
from doughnet.weights import write_atomically

DOUGHNET = str(Path(sys.executable).with_name("doughnet"))


def train(stage: str, out: Path, options: argparse.Namespace, *, recipe: str, seed: int) -> None:
    """Train a stage, or go on with it."""
    command = [DOUGHNET, "train", stage, "--recipe", recipe, "--seed", str(seed), "--resume",
               "--preset", options.preset, "--minutes", str(options.minutes),
               "--sensor", options.sensor, "--dataset", options.dataset,
               "--out", str(out)]  # fmt: skip
    if options.threads is not None:
        command += ["--threads", str(options.threads)]
    subprocess.run([*command, "--json"], check=True, stdout=subprocess.DEVNULL)


def share(stage: str, source: Path, target: Path) -> None:
    """Copy a trained stage, whole or not at all."""
    if (target / stage).exists():
        return
    target.mkdir(parents=True, exist_ok=True)
    part = target / f".tmp-{stage}"
    shutil.rmtree(part, ignore_errors=True)
    shutil.copytree(source / stage, part)
    part.rename(target / stage)


def ablate(recipe: str, seed: int, options: argparse.Namespace) -> None:
    """Train a recipe from a seed and score it."""
    out, full = options.out / f"{recipe}-{seed}", options.out / f"full-{seed}"
    if (out / "evaluation.json").exists():
        return
    if recipe == "full" or RECIPES[recipe].complete:
        train("autoencoder", out, options, recipe=recipe, seed=seed)
    else:
        share("autoencoder", full, out)
    train("dynamics", out, options, recipe=recipe, seed=seed)
    command = [DOUGHNET, "evaluate", "--dataset", options.dataset, "--weights", str(out),
               "--split", options.split, "--sensor", options.sensor, "--json"]  # fmt: skip
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    write_atomically(out / "evaluation.json", done.stdout)


def main() -> None:
    """All recipes of a seed, then the next seed."""
    parser = argparse.ArgumentParser(description="Train and score the ablations.")
    parser.add_argument("--dataset", default="model-dataset")
    parser.add_argument("--out", type=Path, default=Path("model-ablations"))
    parser.add_argument("--preset", default="micro")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=20.0, help="of each stage")
    parser.add_argument("--split", default="test", help="that is scored")
    parser.add_argument("--sensor", default="realsense")
    parser.add_argument("--threads", type=int, help="of the arithmetic (default: all)")
    options = parser.parse_args()
    for seed in range(options.seeds):
        for recipe in RECIPES:
            print(f"ablations: {recipe}, seed {seed}", file=sys.stderr, flush=True)
            try:
                ablate(recipe, seed, options)
            except subprocess.CalledProcessError as error:
                sys.exit(error.returncode)  # the command has said why


if __name__ == "__main__":
    main()
