"""CPU seconds of one whole scene: 75 key frames simulated, checked and meshed, in one process.

python benchmarks/pipeline.py --json

The scene is the default doughnut: a ring of 22.5 mm radius and 8.5 mm tube radius at 2 mm, squeezed
between regular fingers from 100 mm to 5 mm, until its sides merge and a figure eight is left. Each
stage is used once before on a small scene, so that compilation and imports are not counted; they
are in `warm_up_cpu_s`. `--full` takes a scene of every built-in family besides.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from doughdata import registry
from doughdata.mesh.sequence import mesh_frames
from doughdata.scene_work import simulate_scene
from doughdata.scenes.tools import PRESETS
from doughdata.sim.mpm import MpmSimulator, draft
from doughdata.sim.pull import MpmPullApart
from doughschemas import Action, Body, Scene

FRAMES = 75
FAMILIES = ("rolls", "doughnut")
GOAL = 20.0  # [CPU s]; the original code needed about 335 for its default doughnut, another day
Result = TypeVar("Result")


def default_doughnut() -> Scene:
    """The scene that the goal is about."""
    ring = {"ring_radius": 0.0225, "tube_radius": 0.0085}
    return Scene(
        scene_id="default-doughnut",
        family="doughnut",
        region="custom",
        bodies=(Body(shape="ring", parameters=ring),),
        tools=(PRESETS["regular"],),
        actions=(Action(opening_start=0.100, opening_end=0.005),),
    )


def small_scene() -> Scene:
    """A short roll that is cut, so that the check has something to pull at."""
    roll = {"radius": 0.008, "length": 0.040}
    return Scene(
        scene_id="small",
        family="custom",
        region="custom",
        bodies=(Body(shape="roll", parameters=roll),),
        tools=(PRESETS["narrow"],),
        actions=(Action(opening_start=0.024, opening_end=0.001),),
    )


def timed(work: Callable[[], Result]) -> tuple[float, Result]:
    """CPU seconds of this process's threads, and the result."""
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def run(scene: Scene, *, frames: int, mesher: str) -> dict[str, Any]:
    """All three stages on one scene, as the pipeline runs them, less the reading and writing."""
    simulator = MpmSimulator(replace(draft(), frames=frames))
    check = registry.load("topology", "dynamic")(pull_apart=MpmPullApart())
    make = registry.load("meshers", mesher)()
    simulate, particles = timed(lambda: simulate_scene(simulator, scene))
    checked, topology = timed(lambda: check.check(scene, particles))
    meshed, meshes = timed(lambda: mesh_frames(make, particles, topology))
    total = simulate + checked + meshed
    faces = [sum(len(mesh.faces) for mesh in frame.meshes) for frame in meshes]
    return {
        "scene_total_cpu_s": round(total, 2),
        "simulate_cpu_s": round(simulate, 2),
        "topology_cpu_s": round(checked, 2),
        "mesh_cpu_s": round(meshed, 2),
        "shares": {
            "simulate": round(simulate / total, 3),
            "topology": round(checked / total, 3),
            "mesh": round(meshed / total, 3),
        },
        "topology_to_simulation": round(checked / simulate, 3),
        "key_frames": len(meshes),
        "particles": particles.positions.shape[1],
        "faces": int(np.mean(faces)),
        "events": [event.kind for event in topology.events],
        "final_genus": list(topology.frames[-1].genus),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="CPU seconds of one whole scene")
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--full", action="store_true", help="a scene of each family besides")
    parser.add_argument("--frames", type=int, default=FRAMES, help="key frames of the scene")
    parser.add_argument("--mesher", default="dual-contouring", help="registered name")
    options = parser.parse_args()
    warm_up, _ = timed(lambda: run(small_scene(), frames=8, mesher=options.mesher))
    result: dict[str, Any] = {
        "benchmark": "pipeline",
        **run(default_doughnut(), frames=options.frames, mesher=options.mesher),
        "warm_up_cpu_s": round(warm_up, 2),
        "goal_cpu_s": GOAL,
    }
    if options.full:
        result["families"] = {
            family: run(
                registry.load("scenes", family)().sample(seed=0, number=0, split="train"),
                frames=options.frames,
                mesher=options.mesher,
            )
            for family in FAMILIES
        }
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
