"""How fast may fingers close before outcomes change?

    python benchmarks/closing_speed.py --json               a few scenes
    python benchmarks/closing_speed.py --json --scenes 40   the study that SPEC.md quotes

Sampled scenes (half rolls, half doughnuts, draft) are simulated at the reference speed and at
faster ones, checked with the dynamic check, and the final key frame is meshed. Per speed:
`same_topology`, the share of scenes with the reference's final components and genera, and
`occupancy_iou`, the mean intersection over union of the final occupied volume on the 1 mm label
grid. `reseeded` is the control: the reference speed again with other particles. What differs there
is chaos, not speed.
"""

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from statistics import mean, median
from typing import Any

import numpy as np

from doughschemas import LabelGrid, Scene

REFERENCE = 0.025  # [m/s], each finger
SPEEDS = (0.05, 0.1)
SEED = 11
GRID = 0.001  # [m]
WANTED_TOPOLOGY, WANTED_IOU = 0.95, 0.97


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One scene at one speed; `jitter` seeds the particles."""

    number: int
    scene: Scene
    speed: float
    jitter: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What is left at the end."""

    run: Run
    topology: tuple[int, tuple[int, ...], bool]  # components, sorted genera, ambiguous
    cells: frozenset[tuple[int, int, int]]  # occupied nodes of the world's 1 mm grid


def finish(run: Run) -> Outcome:
    """Simulate, check, and mesh the last key frame."""
    from doughdata.mesh.dual_contouring import DualContouring
    from doughdata.sim.mpm import MpmSimulator, draft
    from doughdata.sim.pull import MpmPullApart
    from doughdata.topology.dynamic import DynamicCheck

    actions = tuple(replace(action, speed=run.speed) for action in run.scene.actions)
    scene = replace(run.scene, actions=actions)
    rng = np.random.default_rng((SEED, run.number, run.jitter))
    particles = MpmSimulator(draft()).simulate(scene, rng=rng)
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(scene, particles)
    last = topology.frames[-1]
    meshed = DualContouring().mesh(particles.positions[-1], last, spacing=particles.spacing)
    return Outcome(
        run=run,
        topology=(last.num_components, tuple(sorted(last.genus)), last.ambiguous),
        cells=occupied(meshed.label_grid),
    )


def occupied(grid: LabelGrid) -> frozenset[tuple[int, int, int]]:
    """Indices of the occupied nodes on a grid through the world's origin."""
    inside = np.argwhere(grid.labels != 255) * grid.spacing + grid.origin
    return frozenset(map(tuple, np.round(inside / GRID).astype(int).tolist()))


def iou(a: Outcome, b: Outcome) -> float:
    """Intersection over union of two final volumes."""
    return len(a.cells & b.cells) / max(1, len(a.cells | b.cells))


def sampled(count: int) -> list[Scene]:
    """Scenes of both families of the paper."""
    from doughdata import registry

    families = [registry.load("scenes", name)() for name in ("rolls", "doughnut")]
    return [families[k % 2].sample(seed=SEED, number=k // 2, split="train") for k in range(count)]


def compared(reference: list[Outcome], others: list[Outcome]) -> dict[str, Any]:
    """Shares and overlaps of two lists of outcomes, scene by scene."""
    overlaps = [iou(a, b) for a, b in zip(reference, others, strict=True)]
    same = [a.topology[:2] == b.topology[:2] for a, b in zip(reference, others, strict=True)]
    sure = [
        equal
        for equal, a, b in zip(same, reference, others, strict=True)
        if not (a.topology[2] or b.topology[2])
    ]
    return {
        "same_topology": round(mean(same), 3),
        "same_topology_unambiguous": round(mean(sure), 3) if sure else None,
        "occupancy_iou": round(mean(overlaps), 4),
        "occupancy_iou_median": round(median(overlaps), 4),
        "differ": [
            o.run.scene.scene_id for o, equal in zip(others, same, strict=True) if not equal
        ],
    }


def measure(count: int, speeds: tuple[float, ...], workers: int) -> dict[str, Any]:
    """All runs, and the fastest speed that keeps both limits."""
    scenes = list(enumerate(sampled(count)))
    plans = {"reference": (REFERENCE, 0), "reseeded": (REFERENCE, 1)}
    plans |= {f"{1000 * speed:g}_mm_s": (speed, 0) for speed in speeds}
    runs = [
        Run(number=number, scene=scene, speed=speed, jitter=jitter)
        for speed, jitter in plans.values()
        for number, scene in scenes
    ]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        outcomes = list(pool.map(finish, runs))
    by_plan = {name: outcomes[k * count : (k + 1) * count] for k, name in enumerate(plans)}
    reference = by_plan.pop("reference")
    found = {name: compared(reference, others) for name, others in by_plan.items()}
    kept = [
        speed
        for speed in speeds
        if found[f"{1000 * speed:g}_mm_s"]["same_topology"] >= WANTED_TOPOLOGY
        and found[f"{1000 * speed:g}_mm_s"]["occupancy_iou"] >= WANTED_IOU
    ]
    return {
        "scenes": count,
        "reference_mm_s": 1000 * REFERENCE,
        "fastest_mm_s": 1000 * max(kept, default=REFERENCE),
        **found,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on one line")
    parser.add_argument("--scenes", type=int, default=2, help="40 for the study")
    parser.add_argument("--speeds", default=",".join(map(str, SPEEDS)), help="[m/s]")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    result = measure(
        arguments.scenes, tuple(map(float, arguments.speeds.split(","))), arguments.workers
    )
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:28s} {value}")
