"""Train and score the ablations: every recipe from every seed, one folder each.

    python scripts/ablations.py --dataset model-dataset --preset micro --seeds 3 --minutes 20

OUT/RECIPE-SEED holds the stages and `evaluation.json`, the table of the test split. Recipes that
change the dynamics alone share their seed's autoencoder. Stopped at any moment, the same command
goes on.

`--minutes` are of a clock. With `--jobs 2 --threads 1` two trainings stand side by side on two
cores, and what each does in its minutes is comparable as long as nothing else runs.
"""

import argparse
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

from doughnet.recipes import RECIPES, recipe
from doughnet.weights import write_atomically
from doughschemas import UnknownNameError

DOUGHNET = str(Path(sys.executable).with_name("doughnet"))


def train(stage: str, out: Path, options: argparse.Namespace, *, name: str, seed: int) -> None:
    """Train a stage of the recipe `name`, or go on with it."""
    command = [DOUGHNET, "train", stage, "--recipe", name, "--seed", str(seed), "--resume",
               "--preset", options.preset, "--minutes", str(options.minutes),
               "--sensor", options.sensor, "--dataset", options.dataset,
               "--workers", str(options.workers), "--out", str(out)]  # fmt: skip
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


def ablate(name: str, seed: int, options: argparse.Namespace) -> None:
    """Train a recipe from a seed and score it.

    Raises:
        CalledProcessError: a command failed, and has said why.
    """
    out, full = options.out / f"{name}-{seed}", options.out / f"full-{seed}"
    if (out / "evaluation.json").exists():
        return
    print(f"ablations: {name}, seed {seed}", file=sys.stderr, flush=True)
    if name == "full" or recipe(name).complete:
        train("autoencoder", out, options, name=name, seed=seed)
    else:
        share("autoencoder", full, out)
    train("dynamics", out, options, name=name, seed=seed)
    command = [DOUGHNET, "evaluate", "--dataset", options.dataset, "--weights", str(out),
               "--split", options.split, "--sensor", options.sensor, "--json"]  # fmt: skip
    if options.threads is not None:
        command += ["--threads", str(options.threads)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    write_atomically(out / "evaluation.json", done.stdout)


def ablate_all(names: list[str], options: argparse.Namespace) -> None:
    """Some recipes from all seeds, `jobs` at a time; the first failure is raised at the end."""
    with ThreadPoolExecutor(options.jobs) as pool:
        pairs = product(range(options.seeds), names)
        running = [pool.submit(ablate, name, seed, options) for seed, name in pairs]
    for job in running:
        job.result()


def main() -> None:
    """The full recipe from every seed, whose autoencoder the others share; then these."""
    parser = argparse.ArgumentParser(description="Train and score the ablations.")
    parser.add_argument("--dataset", default="model-dataset")
    parser.add_argument("--out", type=Path, default=Path("model-ablations"))
    parser.add_argument("--preset", default="micro")
    parser.add_argument("--recipes", default=",".join(RECIPES), metavar="NAME[,NAME]")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=20.0, help="of each stage")
    parser.add_argument("--split", default="test", help="that is scored")
    parser.add_argument("--sensor", default="realsense")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time")
    parser.add_argument("--threads", type=int, help="of the arithmetic of each (default: all)")
    parser.add_argument("--workers", type=int, default=1, help="processes that read, for each")
    options = parser.parse_args()
    try:
        others = [name for name in options.recipes.split(",") if recipe(name) != recipe("full")]
        ablate_all(["full"], options)
        ablate_all(others, options)
    except UnknownNameError as error:
        parser.error(str(error))
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)  # the command has said why


if __name__ == "__main__":
    main()
