"""Actions: sequences, limits on every number, fingers that would start inside dough."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.scenes import check_scene, scene_from_json, scene_to_json, tool_preset
from doughdata.sim.mpm import MpmConfig, MpmSimulator
from doughdata.sim.script import tool_poses
from doughschemas import Action, Body, Scene, SceneError, SimulationError, Tool

BALL = Body(shape="ball", parameters={"radius": 0.010})
QUICK = MpmConfig(spacing=0.0025, frames=5, settle=0.02)


def scene(*actions: Action, tools: tuple[Tool, ...] = ()) -> Scene:
    return Scene(
        scene_id="x",
        family="custom",
        bodies=(BALL,),
        tools=tools or (tool_preset("regular"), tool_preset("wide")),
        actions=actions,
    )


def simulate(wanted: Scene, config: MpmConfig = QUICK):
    return MpmSimulator(config).simulate(wanted, rng=np.random.default_rng(0))


NUMBERS = [f.name for f in fields(Action) if f.name not in ("tool", "release")]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("number", [0, 1])
def test_no_number_of_an_action_may_be_nan_or_infinite(
    name: str, value: float, number: int
) -> None:
    """Each one is refused with the action's number and the field's name, in JSON as well."""
    bad = replace(Action(), **{name: (0.0, value) if name == "position" else value})
    steps = [Action(), Action()]
    steps[number] = bad
    with pytest.raises(SceneError, match=rf"action {number}: {name}"):
        check_scene(scene(*steps))
    data = scene_to_json(scene(Action(), Action()))
    data["actions"][number][name] = [0.0, value] if name == "position" else value
    with pytest.raises(SceneError, match=rf"actions\[{number}\]\.{name} must be float and finite"):
        scene_from_json(json.loads(json.dumps(data)))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("bodies", 0, "position"), [0, math.nan]),
        (("bodies", 0, "position"), ["a", "b"]),
        (("bodies", 0, "yaw"), math.nan),
        (("bodies", 0, "parameters"), [1]),
        (("bodies", 0, "parameters"), {"radius": math.nan}),
        (("tools", 1, "friction"), math.inf),
        (("tools", 1, "mesh"), 7),
        (("actions", 0, "tool"), 0.5),
        (("actions", 0, "release"), 1),
        (("actions", 0, "speed"), 10**400),
        (("material", "density"), math.nan),
    ],
)
def test_json_errors_name_the_place(place: tuple, value: object) -> None:
    """A wrong value is refused with the path of the field that holds it."""
    data = json.loads(json.dumps(scene_to_json(scene(Action()))))
    inner = data
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place)
    with pytest.raises(SceneError) as caught:
        scene_from_json(data, name="mine")
    assert f"mine: {name[1:]}" in str(caught.value)


@pytest.mark.parametrize("field", ["yaw", "position"])
def test_bodies_of_a_record_are_finite_too(field: str) -> None:
    """A scene built in Python is held to the same limits."""
    bad = replace(BALL, **{field: math.nan if field == "yaw" else (math.nan, 0.0)})
    with pytest.raises(SceneError, match=f"body 0: {field}"):
        check_scene(replace(scene(Action()), bodies=(bad,)))


def test_a_finger_set_down_inside_dough_ends_the_scene() -> None:
    """The error says which action, which finger and where, and what to change."""
    narrow = Action(position=(0.013, 0.0), opening_start=0.010, opening_end=0.005, speed=0.1)
    first = Action(opening_start=0.030, opening_end=0.025, speed=0.1)
    with pytest.raises(SimulationError, match="action 1: finger 1 would start inside the dough"):
        simulate(scene(first, narrow))


def test_a_mesh_finger_inside_dough_is_refused_at_the_first_action(tmp_path: Path) -> None:
    """What box limits cannot see, the simulator does: a mesh finger over the ball."""
    path = tmp_path / "block.stl"
    trimesh.creation.box(bounds=[[0, -5, 0], [10, 5, 40]]).export(path)
    block = Tool(name="block", mesh=str(path), scale=0.001)
    act = Action(opening_start=0.010, opening_end=0.005, speed=0.1)
    with pytest.raises(SimulationError, match=r"action 0: finger 0 would start inside"):
        simulate(scene(act, tools=(block,)))


def test_dough_does_not_feel_a_gripper_that_moves_between_actions() -> None:
    """Squeezes far from the dough, however many and wherever, leave it as one squeeze does."""
    far = Action(position=(0.08, 0.08), opening_start=0.012, opening_end=0.010, speed=0.05)
    moved = replace(far, position=(-0.08, 0.08), yaw=1.0, tool=0)
    one, two = simulate(scene(far)), simulate(scene(far, moved))
    np.testing.assert_allclose(one.positions[-1], two.positions[-1], atol=2e-4)


def test_two_actions_squeeze_along_their_own_axes() -> None:
    """After a squeeze along x and one along y, each axis was as narrow as its opening, in turn."""
    steps = (
        Action(tool=1, opening_start=0.030, opening_end=0.014, speed=0.1, release=True),
        Action(
            tool=1, yaw=math.pi / 2, opening_start=0.060, opening_end=0.014, speed=0.1, release=True
        ),
    )
    wanted = scene(*steps)
    config = replace(QUICK, frames=129)
    done = simulate(wanted, config)
    poses = tool_poses(wanted, done.timestamps)
    for index, axis in ((0, 0), (1, 1)):
        mine = poses.action == index
        closed = np.flatnonzero(mine)[poses.opening[mine].argmin()]
        half = np.abs(done.positions[closed][:, axis]).max()
        assert half < poses.opening[closed] / 2 + config.cells * config.spacing / 2
        assert np.abs(done.positions[closed][:, 1 - axis]).max() > half
