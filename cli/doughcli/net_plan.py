"""`doughnet plan`: which squeeze turns the dough that is seen into the goal?"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from doughcli.net_options import (
    SensorOption,
    ShareBar,
    ThreadsOption,
    WeightsOption,
    use_threads,
)
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json
from doughschemas import Action, BadInputError, Scene, Tool

__all__ = ["command"]

NAME = "plan"
HELP = (
    "Search for the tool, pose and final opening whose predicted outcome is most like a goal: a "
    "key frame (SCENE:FRAME or URI#SCENE:FRAME), a mesh, or a point cloud with a colour for each "
    "component. --verify carries the plan out in the simulator."
)
EPILOG = "Example: doughnet plan --start 0:5 --goal 0:65 --tools narrow,regular,wide --verify"
NUM_FRAMES = 75  # key frames of a scene that was not simulated


def command(
    goal: Annotated[str, typer.Option("--goal", metavar="G", help="What is to be reached.")],
    start: Annotated[
        str, typer.Option("--start", metavar="S", help="Where the dough is now, given like a goal.")
    ] = "0:5",
    dataset: DatasetOption = DATASET_DEFAULT,
    weights: WeightsOption = None,
    sensor: SensorOption = "realsense",
    tools: Annotated[
        str,
        typer.Option(metavar="T,T", help="Presets, tool meshes (file), or `scene`: the start's."),
    ] = "narrow,regular,wide",
    samples: Annotated[int, typer.Option(min=1, help="Squeezes a round.")] = 64,
    elites: Annotated[int, typer.Option(min=1, help="Best of them that are kept.")] = 8,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of the search.")] = 10,
    reach: Annotated[float, typer.Option(metavar="MM", help="Greatest |x| and |y|.")] = 40.0,
    turn: Annotated[float, typer.Option(metavar="DEG", help="Greatest turn.")] = 10.0,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    verify: Annotated[
        bool, typer.Option("--verify", help="Carry the plan out in the simulator and compare.")
    ] = False,
    save: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for plan.json, scene.json and plan.html.")
    ] = Path("doughnet-plan"),
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan, save, verify, print."""
    use_threads(threads)
    from doughcli.net_gripper import ToolGripper, dough_at_start
    from doughcli.net_sources import read_source
    from doughcli.net_trial import planned_scene, try_plan
    from doughdata.scenes.json import scene_to_json
    from doughnet.data import KEY_FRAMES
    from doughnet.planner import Planner
    from doughnet.runs import find_weights
    from doughnet.weights import load_weights

    config = _config(samples, elites, rounds, reach, turn, seed)
    model = load_weights(find_weights(weights)).model
    begin = read_source(start, dataset=dataset, sensor=sensor)
    end = read_source(goal, dataset=dataset, sensor=sensor)
    num_frames, frames = NUM_FRAMES, KEY_FRAMES
    if begin.scene is not None and begin.frame is not None:
        first, num_frames = begin.frame.frame_index, begin.num_frames
        frames = tuple(frame for frame in begin.key_frames if frame >= first)
        if len(frames) < 2:
            raise BadInputError(f"--start {start}: no key frame is left after {first}")
    gripper = ToolGripper(
        _tools(tools, begin.scene), _template(begin.scene), frames=frames, num_frames=num_frames,
        dough=dough_at_start(begin, model),
    )  # fmt: skip
    planner = Planner(
        model, gripper, start=(begin.points, begin.labels), goal=(end.points, end.labels)
    )
    with ShareBar("plan", quiet=as_json) as bar:
        plan = planner.plan(
            config,
            progress=lambda done, every, best: bar.advance(done / every, {"cosine": best}),
        )
    _make(save)
    shape = model.decode(planner.start)
    scene = planned_scene(begin, gripper, plan.squeeze, shape=shape, folder=save)
    found = {"start": begin.name, "goal": end.name, **plan.to_json()}
    if verify:
        found["verified"] = try_plan(scene, end, frame=frames[-1], num_frames=num_frames)
    from doughcli.net_plan_page import plan_page

    shapes = [model.decode(planner.latents([r.squeezes[0]])[0, -1]) for r in plan.rounds]
    _write(save / "plan.json", _json(found))
    _write(save / "scene.json", _json(scene_to_json(scene)))
    page = save / "plan.html"
    _write(page, plan_page(plan, shapes, begin, end, gripper, found))
    if as_json:
        emit_json({"page": str(page), **{k: v for k, v in found.items() if k != "rounds"}})
        return
    _print(found)
    print(f"{save}/plan.html, plan.json; doughdata generate --scenes {save}/scene.json")


def _config(samples: int, elites: int, rounds: int, reach: float, turn: float, seed: int) -> Any:
    from math import radians

    from doughnet.search import SearchConfig

    if not (0 < reach <= 100 and 0 < turn <= 180):
        raise BadInputError(f"--reach must be within 0..100 mm, --turn 0..180, got {reach}, {turn}")
    return SearchConfig(
        samples=samples,
        elites=elites,
        iterations=rounds,
        reach=reach / 1000,
        turn=radians(turn),
        turn_spread=radians(turn),
        seed=seed,
    )


def _tools(names: str, scene: Scene | None) -> Mapping[str, Tool]:
    """Tools by name.

    Raises:
        UnknownNameError: no such preset.
        SceneError: a mesh that cannot be used.
        BadInputError: the start has no tool of its own, or no name at all.
    """
    from doughdata.scenes.tools import finger_mesh, tool_preset

    found: dict[str, Tool] = {}
    for name in filter(None, (part.strip() for part in names.split(","))):
        if name == "scene":
            if scene is None:
                raise BadInputError("--tools scene: the start is no simulated key frame")
            found[scene.tools[0].name] = scene.tools[0]
        elif Path(name).suffix:
            tool = Tool(name=Path(name).stem, mesh=name)
            finger_mesh(tool)
            found[tool.name] = tool
        else:
            found[name] = tool_preset(name)
    if not found:
        raise BadInputError("--tools needs at least one name")
    return found


def _template(scene: Scene | None) -> Action:
    """The action whose speed, first opening and holding a plan keeps."""
    if scene is not None:
        return scene.actions[0]
    squeeze = Action()
    return Action(hold=squeeze.duration / 6)  # as the sampled families hold


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"cannot make {folder}: {error.strerror or error}") from error


def _json(data: Any) -> str:
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error


def _print(found: dict[str, Any]) -> None:
    squeeze = found["squeeze"]
    x, y = (1000 * value for value in squeeze["position"])
    print(
        f"{squeeze['tool']} at ({x:.1f}, {y:.1f}) mm, turned {squeeze['yaw_deg']:.1f} degrees, "
        f"down to {1000 * squeeze['opening']:.1f} mm; cosine with the goal {found['score']:.4f}"
    )
    if result := found.get("verified"):
        print(
            f"carried out: genus {result['genus']}, wanted {result['goal_genus']}, "
            f"VIoU {result['viou']}, CIoU {result['ciou']}"
        )
