"""Speed of many scenes simulated together, on a GPU or, for comparison, on one CPU thread.

    python benchmarks/simulation_gpu.py --json --arch cuda

Doughnuts of 2 mm particles, squeezed by the regular tool: million particle-substeps a second of
1, 8 and 64 clouds in a batch (fingers in the dough), and whole scenes a minute, compilation left
out. Wall time, best of three, because that is what a GPU takes; `solver_mpps` is the CPU's solver
on one of the clouds, in the same run. Without `--arch` it is a CUDA device where there is one.
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np

from doughdata.scenes import PRESETS
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim._taichi import gpu_present
from doughdata.sim.batch import BatchSolver
from doughdata.sim.mpm import MpmConfig, MpmSimulator, fill_bodies
from doughdata.sim.script import Stretch
from doughdata.sim.solver import Solver, Squeeze
from doughschemas import Action, Body, Particles, Scene

BATCHES, REPEATS, DT = (1, 8, 64), 3, 1e-4
SCENE = Scene(
    scene_id="benchmark",
    family="doughnut",
    bodies=(Body(shape="ring"),),
    tools=(PRESETS["regular"],),
    actions=(Action(),),
)


def clouds(count: int, arch: str) -> list[Solver]:
    """Rings that differ in their jitter alone."""
    simulator = MpmSimulator(MpmConfig(arch=arch))
    return [
        Solver(
            fill_bodies(SCENE, simulator.config, np.random.default_rng(k))[0],
            simulator._physics(SCENE),
            arch=arch,
        )
        for k in range(count)
    ]


def squeeze() -> Squeeze:
    """Fingers that just touch the ring's outer sides."""
    return Squeeze(
        sdf=finger_sdf(PRESETS["regular"]),
        position=(0.0, 0.0),
        yaw=0.0,
        opening=0.070,
        rate=-0.1,
        friction=PRESETS["regular"].friction,
    )


def best_seconds(run: Callable[[], object]) -> float:
    """Wall time, best of three."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def measure_batch(count: int, arch: str, steps: int) -> tuple[float, float]:
    """Million particle-substeps a second, and megabytes on the device."""
    together = clouds(count, arch)
    batch = BatchSolver(together, arch=arch)
    stretch = Stretch(seconds=steps * DT, squeeze=squeeze(), steps=steps)
    batch.advance([Stretch(seconds=5 * DT, squeeze=squeeze(), steps=5)] * count)  # compiles
    seconds = best_seconds(lambda: batch.advance([stretch] * count))
    if any(batch.errors):
        raise SystemExit(f"a cloud failed: {batch.errors}")
    particles = sum(len(cloud.x) for cloud in together)
    return particles * steps / seconds / 1e6, batch.megabytes


def measure_solver(steps: int) -> float:
    """Million particle-substeps a second of the CPU's solver on one cloud."""
    (cloud,) = clouds(1, "cpu")
    cloud.advance(5 * DT, squeeze=squeeze(), steps=5)
    seconds = best_seconds(lambda: cloud.advance(steps * DT, squeeze=squeeze(), steps=steps))
    return len(cloud.x) * steps / seconds / 1e6


def measure_scenes(count: int, arch: str) -> float:
    """Whole scenes a minute, 75 key frames each."""
    rngs = [np.random.default_rng(k) for k in range(count)]
    begin = time.perf_counter()
    results = MpmSimulator(MpmConfig(arch=arch)).simulate_batch([SCENE] * count, rngs=rngs)
    seconds = time.perf_counter() - begin
    if not all(isinstance(result, Particles) for result in results):
        raise SystemExit(f"a scene failed: {results}")
    return 60 * count / seconds


def measure(arch: str, *, scenes: int, steps: int) -> dict[str, float | str]:
    """All figures of this file."""
    figures: dict[str, float | str] = {"arch": arch, "solver_mpps": measure_solver(steps)}
    figures["particles"] = len(clouds(1, arch)[0].x)
    for count in BATCHES:
        mpps, megabytes = measure_batch(count, arch, steps)
        figures |= {f"mpps_{count}": mpps, f"megabytes_{count}": megabytes}
    if scenes:
        figures |= {"scenes": scenes, "scenes_per_minute": measure_scenes(scenes, arch)}
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--arch", choices=["cpu", "cuda", "vulkan"])
    parser.add_argument("--scenes", type=int, help="whole scenes together; 64 on CUDA, else none")
    parser.add_argument("--steps", type=int, help="substeps; 200 on CUDA, else 10")
    arguments = parser.parse_args()
    arch = arguments.arch or ("cuda" if gpu_present("cuda") else "cpu")
    scenes = arguments.scenes if arguments.scenes is not None else 64 if arch == "cuda" else 0
    figures = measure(arch, scenes=scenes, steps=arguments.steps or (200 if arch == "cuda" else 10))
    if arguments.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:28s} {value}")
