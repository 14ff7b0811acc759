"""The dynamic check: is it right, does it know when it is unsure, and what does it cost?

    python benchmarks/topology.py --json                 20 sampled scenes, one seed a truth case
    python benchmarks/topology.py --json --scenes 100    all seeds; what the README quotes
    python benchmarks/topology.py --json --full          also every threshold moved by 20 %

With `--log FILE` a run that was stopped goes on: what the file holds is not made again.

`graph_mesh_agreement` and `persistence_agreement` are shares of the key frames that the check is
sure of, over sampled scenes (half `rolls`, half `doughnut`); `ambiguous` and `ambiguous_final` are
shares of all key frames and of the last ones. `truth_table` is the share of right outcomes,
`truth_table_holdout` that of the half that no threshold was chosen on. `check_cpu_s` is of one
default doughnut, `check_share` the CPU time of the checks over that of the simulations.
Persistence needs gudhi; without it that key is null.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from topology_judges import mesh_genus, persistence_agrees
from topology_sensitivity import Moved, threshold_sensitivity
from topology_truth import SEEDS, Case, truth_table

from doughdata.scene_work import simulate_scene
from doughdata.scenes import load_family
from doughdata.scenes.tools import PRESETS
from doughdata.sim.mpm import MpmSimulator
from doughdata.sim.pull import MpmPullApart
from doughdata.topology.dynamic import DynamicCheck
from doughschemas import Action, Body, Particles, Scene, Topology

FAMILIES = ("rolls", "doughnut")
SEED = 7
MESHED = 3  # every third key frame is meshed
SAMPLED = 2  # key frames a scene that are judged by persistence


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """A scene, played and checked, with the CPU seconds of both."""

    scene: Scene
    particles: Particles
    topology: Topology
    simulation_s: float
    check_s: float


def play(scene: Scene) -> Checked:
    """Simulate and check one scene with the product's own stages."""
    start = time.process_time()
    particles = simulate_scene(MpmSimulator(), scene)
    middle = time.process_time()
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(scene, particles)
    return Checked(
        scene=scene,
        particles=particles,
        topology=topology,
        simulation_s=middle - start,
        check_s=time.process_time() - middle,
    )


def default_doughnut() -> Scene:
    """The default ring, squeezed across its hole by the regular tool from 100 mm to 5 mm."""
    return Scene(
        scene_id="default-doughnut",
        family="doughnut",
        region="custom",
        bodies=(Body(shape="ring"),),
        tools=(PRESETS["regular"],),
        actions=(Action(opening_end=0.005),),
    )


def judged(done: Checked, rng: np.random.Generator, *, persistence: bool) -> dict[str, Any]:
    """What the judges say of the key frames of one scene that the check is sure of."""
    frames = done.topology.frames
    sure = [k for k, frame in enumerate(frames) if not frame.ambiguous]
    meshed = [k for k in sure if k % MESHED == 0 or k == len(frames) - 1]
    differ = [k for k in meshed if mesh_genus(done.particles, frames[k], k) != frames[k].genus]
    asked = rng.choice(sure, min(SAMPLED, len(sure)), replace=False) if persistence else []
    agree = [persistence_agrees(done.particles, frames[k], int(k)) for k in asked]
    last = frames[-1]
    return {
        "scene": done.scene.scene_id,
        "components": last.num_components,
        "genus": sorted(last.genus),
        "frames": len(frames),
        "ambiguous": len(frames) - len(sure),
        "ambiguous_final": last.ambiguous,
        "meshed": len(meshed),
        "mesh_differs": differ,
        "persistence_asked": len(asked),
        "persistence_agrees": int(sum(agree)),
        "simulation_s": round(done.simulation_s, 2),
        "check_s": round(done.check_s, 2),
    }


def sampled(number: int) -> Scene:
    """Scene `number` of those that are judged: the families take turns."""
    family = load_family(FAMILIES[number % len(FAMILIES)])
    return family.sample(seed=SEED, number=number // len(FAMILIES), split="train")


def judged_scene(number: int) -> dict[str, Any]:
    """Play, check and judge one sampled scene."""
    rng = np.random.default_rng([SEED, number])
    return judged(play(sampled(number)), rng, persistence=find_spec("gudhi") is not None)


def over_scenes(
    task: Callable[[int], dict[str, Any]], count: int, log: Path | None, pool: Executor
) -> list[dict[str, Any]]:
    """The rows of a task for sampled scenes, in order; `log` gets each as it comes."""
    known: dict[int, dict[str, Any]] = {}
    if log is not None and log.exists():
        with log.open() as file:
            entries = [json.loads(line) for line in file]
        known = {one["number"]: one["row"] for one in entries if one["task"] == task.__name__}
    left = [number for number in range(count) if number not in known]
    for number, row in zip(left, pool.map(task, left), strict=True):
        known[number] = row
        if log is not None:
            with log.open("a") as file:
                entry = {"task": task.__name__, "number": number, "row": row}
                file.write(json.dumps(entry) + "\n")
    return [known[number] for number in range(count)]


def right_case(case: Case) -> bool:
    """Play one case of the truth table."""
    return case.right(play(case.scene).topology)


def over_truth(seeds: tuple[int, ...], pool: Executor) -> dict[str, Any]:
    """Shares of right outcomes of the truth table."""
    names, cases = zip(*truth_table(seeds), strict=True)
    right = dict(zip(names, pool.map(right_case, cases), strict=True))
    halves = dict(zip(names, (case.half for case in cases), strict=True))
    held_out = [right[name] for name in names if halves[name] == "holdout"]
    return {
        "truth_table": sum(right.values()) / len(right),
        "truth_table_holdout": sum(held_out) / len(held_out),
        "truth_cases": len(right),
        "wrong": [name for name, ok in right.items() if not ok],
    }


def shares(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures over all sampled scenes."""
    total = {key: sum(row[key] for row in rows) for key in ("frames", "ambiguous", "meshed")}
    asked = sum(row["persistence_asked"] for row in rows)
    differ = sum(len(row["mesh_differs"]) for row in rows)
    agree = sum(row["persistence_agrees"] for row in rows)
    ends = Counter((row["scene"].split("-")[0], str(row["genus"])) for row in rows)
    cpu = [sum(row[key] for row in rows) for key in ("check_s", "simulation_s")]
    return {
        "scenes": len(rows),
        "graph_mesh_agreement": round(1 - differ / max(total["meshed"], 1), 4),
        "meshed_frames": total["meshed"],
        "ambiguous": round(total["ambiguous"] / total["frames"], 4),
        "ambiguous_final": round(sum(row["ambiguous_final"] for row in rows) / len(rows), 4),
        "persistence_agreement": round(agree / asked, 4) if asked else None,
        "persistence_frames": asked,
        "check_share": round(cpu[0] / cpu[1], 3),
        "final_genera": {f"{family} {ends_in}": n for (family, ends_in), n in sorted(ends.items())},
    }


def sensitive_scene(number: int) -> dict[str, Any]:
    """The moved thresholds that change the final genera of one sampled scene."""
    scene = sampled(number)
    moved = Moved(scene, simulate_scene(MpmSimulator(), scene))
    return {"scene": scene.scene_id, "genus": moved.genus, "changed": moved.changed()}


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    parser.add_argument("--scenes", type=int, default=20, help="sampled scenes, over both families")
    parser.add_argument("--full", action="store_true", help="move every threshold: hours")
    parser.add_argument("--workers", type=int, default=1, help="scenes played at a time")
    parser.add_argument("--log", type=Path, help="keep the result of every scene in this file")
    options = parser.parse_args()
    thorough = options.full or options.scenes >= 100
    doughnut = default_doughnut()
    play(doughnut)  # once before, so that no compilation is counted
    result: dict[str, Any] = {"check_cpu_s": round(play(doughnut).check_s, 2)}
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        result |= over_truth(SEEDS if thorough else SEEDS[:1], pool)
        result |= shares(over_scenes(judged_scene, options.scenes, options.log, pool))
        if options.full:
            rows = over_scenes(sensitive_scene, options.scenes, options.log, pool)
            result["threshold_sensitivity"] = threshold_sensitivity(rows)
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
