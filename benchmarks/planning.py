"""Planning with a trained model: held-out scenes, whose own squeeze is to be found again.

    python benchmarks/planning.py --json --dataset model-dataset --weights model-run

The start of a plan is the first key frame that the model looks at, its goal the last one, both as
depth alone. `translation_mm` and `rotation_deg` are medians of the distance to the squeeze that
made the goal, `tool_accuracy` the share of plans with its tool (of three, at its scale), and
`topology_reached` the share whose outcome in the simulator has the goal's components and genera
(`--no-verify` leaves that out, which saves most of the time); `failed` plans cannot be simulated.
`plan_s` is the median wall time.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from doughcli.net_gripper import ToolGripper, dough_at_start
from doughcli.net_sources import Source, read_source
from doughcli.net_trial import planned_scene, try_plan
from doughdata.dataset import open_dataset
from doughdata.scenes.tools import PRESETS
from doughnet.data import key_frames
from doughnet.model import DoughNet
from doughnet.planner import Planner
from doughnet.runs import find_weights
from doughnet.search import SearchConfig
from doughnet.weights import load_weights
from doughschemas import DoughError, Scene, Tool


def tools_of(scene: Scene) -> dict[str, Tool]:
    """All presets, the scene's own tool in the place of its namesake."""
    own = scene.tools[scene.actions[0].tool]
    return {**PRESETS, own.name: own}


def off_by(planned: Any, scene: Scene) -> dict[str, Any]:
    """How far a squeeze is from the one that the scene was made with."""
    action = scene.actions[0]
    apart = np.subtract(planned.position, action.position)
    turned = (planned.yaw - action.yaw + np.pi / 2) % np.pi - np.pi / 2
    return {
        "translation_mm": 1000 * float(np.hypot(*apart)),
        "rotation_deg": abs(float(np.degrees(turned))),
        "opening_mm": 1000 * abs(planned.opening - action.opening_end),
        "tool": planned.tool == scene.tools[action.tool].name,
    }


def one_plan(
    model: DoughNet, start: Source, goal: Source, config: SearchConfig, *, verify: bool
) -> dict[str, Any]:
    """Plan from one frame of a scene to another, and carry the plan out."""
    scene = start.scene
    assert scene is not None
    frames = start.key_frames
    gripper = ToolGripper(
        tools_of(scene),
        scene.actions[0],
        frames=frames,
        num_frames=start.num_frames,
        dough=dough_at_start(start, model),
    )
    begun = time.perf_counter()
    planner = Planner(
        model, gripper, start=(start.points, start.labels), goal=(goal.points, goal.labels)
    )
    plan = planner.plan(config)
    found = {
        "scene": scene.scene_id,
        "plan_s": time.perf_counter() - begun,
        "score": plan.score,
        **off_by(plan.squeeze, scene),
    }
    if verify:
        found |= verified(model, planner, plan.squeeze, start, goal)
    return found


def verified(
    model: DoughNet, planner: Planner, squeeze: Any, start: Source, goal: Source
) -> dict[str, Any]:
    """What the simulator makes of a plan; one that it cannot carry out reaches nothing."""
    gripper: Any = planner.gripper
    shape = model.decode(planner.start)
    try:
        with TemporaryDirectory() as folder:
            played = planned_scene(start, gripper, squeeze, shape=shape, folder=Path(folder))
            frame = start.key_frames[-1]
            tried = try_plan(played, goal, frame=frame, num_frames=start.num_frames)
    except DoughError as error:
        return {"topology_reached": False, "viou": 0.0, "ciou": 0.0, "failed": str(error)}
    return {name: tried[name] for name in ("topology_reached", "viou", "ciou")}


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    parser.add_argument("--goals", type=int, default=10, help="held-out scenes")
    parser.add_argument("--dataset", default="model-dataset")
    parser.add_argument("--weights", help="folder of trained weights (default: the shipped)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--sensor", default="realsense")
    parser.add_argument("--no-verify", action="store_true", help="do not simulate the plans")
    options = parser.parse_args()
    try:
        result = measure(options)
    except DoughError as error:
        result = {"goals": 0, "not_measured": str(error)}
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All figures; `plans` holds those of every goal."""
    model = load_weights(find_weights(options.weights)).model
    source = open_dataset(options.dataset)
    frames = key_frames(source, options.sensor)
    splits = source.scenes["split"].to_pylist()
    scenes = [k for k, s in zip(source.scene_indices, splits, strict=True) if s == options.split]
    config = SearchConfig(turn=np.pi / 2, turn_spread=np.pi / 2, reach=0.02)
    rows = []
    for number, scene in enumerate(scenes[: options.goals]):
        start, goal = (
            read_source(f"{scene}:{frame}", dataset=options.dataset, sensor=options.sensor)
            for frame in (frames[0], frames[-1])
        )
        seeded = replace(config, seed=number)
        rows.append(one_plan(model, start, goal, seeded, verify=not options.no_verify))
    result: dict[str, Any] = {"goals": len(rows)}
    for name in ("translation_mm", "rotation_deg", "opening_mm", "plan_s"):
        result[name] = round(float(np.median([row[name] for row in rows])), 2)
    result["tool_accuracy"] = round(float(np.mean([row["tool"] for row in rows])), 3)
    if not options.no_verify:
        reached = [bool(row["topology_reached"]) for row in rows]
        result["topology_reached"] = round(float(np.mean(reached)), 3)
        result["failed"] = sum("failed" in row for row in rows)
        result["viou"] = round(float(np.median([row["viou"] for row in rows])), 2)
    result["plans"] = rows
    return result


if __name__ == "__main__":
    main()
