"""Scenes: sampling, limits, JSON."""

import json
import math

import numpy as np
import pytest

from doughdata import registry
from doughdata.scenes import (
    PRESETS,
    check_scene,
    finger_mesh,
    finger_poses,
    opening_at,
    read_scenes,
    scene_from_json,
    scene_to_json,
    shape_of,
)
from doughdata.scenes.regions import REGIONS
from doughschemas import Action, Body, Scene, SceneError, Tool, UnknownNameError

FAMILIES = {
    "rolls": (0.008, 0.014, "radius"),
    "doughnut": (0.018, 0.030, "ring_radius"),
    "roll": (0.008, 0.014, "radius"),
    "ball": (0.012, 0.020, "radius"),
    "pretzel": (0.014, 0.018, "ring_radius"),
}


def sample(family: str, **key: object) -> Scene:
    return registry.load("scenes", family)().sample(
        **{"seed": 0, "number": 0, "split": "train", **key}
    )


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_key_gives_the_same_scene(family: str) -> None:
    """A scene depends on seed, split and number alone, and each of them matters."""
    one = sample(family, seed=7, number=3)
    assert one == sample(family, seed=7, number=3)
    others = [sample(family, seed=8, number=3), sample(family, seed=7, number=4)]
    others.append(sample(family, seed=7, number=3, split="test"))
    assert all(one.bodies != other.bodies for other in others)


@pytest.mark.parametrize("family", FAMILIES)
def test_train_and_test_scales_are_disjoint(family: str) -> None:
    """The body scale of a scene lies in the intervals of its region; train excludes test."""
    low, high, field = FAMILIES[family]
    for split, regions in (("train", {"train"}), ("test", {"interpolation", "extrapolation"})):
        scenes = [sample(family, number=i, split=split) for i in range(60)]
        assert {scene.region for scene in scenes} == regions
        for scene in scenes:
            u = (float(scene.bodies[0].parameters[field]) - low) / (high - low)
            assert any(a - 1e-3 <= u <= b + 1e-3 for a, b in REGIONS[scene.region])
            inside_train = any(a <= u <= b for a, b in REGIONS["train"])
            assert inside_train == (split == "train")


def test_every_tool_preset_occurs() -> None:
    """The sampler draws all three fingers, from a 3 mm blade to a 100 mm vise."""
    tools = [sample("rolls", number=i).tools[0] for i in range(60)]
    assert {tool.name for tool in tools} == set(PRESETS)
    assert all(0.003 <= tool.width <= 0.100 for tool in tools)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_sampled_cutter_passes_the_dough_and_a_vise_leaves_some(family: str) -> None:
    """Fingers that cut are deeper than half of the dough across; vises do not close to a film."""
    for i in range(40):
        scene = sample(family, number=i)
        tool, action = scene.tools[0], scene.actions[0]
        across = max(
            float(np.ptp(np.append(shape_of(body).bounds()[:, 0] + body.position[0], 0.0)))
            for body in scene.bodies
        )
        if tool.width > 0.030:
            assert action.opening_end >= 0.005
        else:
            assert tool.depth >= across or family in ("doughnut", "pretzel")


@pytest.mark.parametrize("shape", ["roll", "ring"])
def test_shape_volume_is_the_closed_form(shape: str) -> None:
    """Counting grid points inside a round roll or torus gives its volume within 1 %."""
    solid = shape_of(Body(shape=shape))
    low, high = solid.bounds()
    h = 0.0005
    axes = [np.arange(a + h / 2, b, h) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    volume = solid.contains(grid).sum() * h**3
    expected = {
        "roll": math.pi * 0.010**2 * 0.060,
        "ring": 2 * math.pi**2 * 0.0225 * 0.0085**2,
    }
    assert volume == pytest.approx(expected[shape], rel=0.01)


def test_fingers_face_each_other() -> None:
    """The contact faces are `opening` apart along the closing axis and point at each other."""
    action = Action(position=(0.01, -0.02), yaw=0.7)
    position, quaternion = finger_poses(action, 0.03)
    axis = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    np.testing.assert_allclose(position.mean(0), [0.01, -0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(position[0] - position[1], 0.03 * axis, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0)
    for finger, sign in ((0, 1.0), (1, -1.0)):
        yaw = 2 * math.atan2(quaternion[finger, 2], quaternion[finger, 3])
        np.testing.assert_allclose([math.cos(yaw), math.sin(yaw)], sign * axis[:2], atol=1e-12)


def test_opening_follows_the_action() -> None:
    """Closing, holding and opening happen at the stated speed and end where they began."""
    action = Action(opening_start=0.10, opening_end=0.02, speed=0.02, hold=0.5, release=True)
    assert action.duration == pytest.approx(2.0 + 0.5 + 2.0)
    for time, opening, speed in (
        (0.0, 0.10, 0.02),
        (1.0, 0.06, 0.02),
        (2.2, 0.02, 0.0),
        (3.5, 0.06, -0.02),
    ):
        assert opening_at(action, time) == pytest.approx((opening, speed))
    assert opening_at(action, 99.0) == pytest.approx((0.10, 0.0))


@pytest.mark.parametrize("name", PRESETS)
def test_finger_mesh_is_the_box_of_its_tool(name: str) -> None:
    """A box finger is closed, starts at x = 0 and z = 0, and has the volume of its sizes."""
    tool = PRESETS[name]
    mesh = finger_mesh(tool)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(tool.depth * tool.width * tool.height)
    np.testing.assert_allclose(mesh.bounds[0], [0.0, -tool.width / 2, 0.0], atol=1e-12)


def valid() -> dict:
    return scene_to_json(sample("rolls"))


BROKEN = {
    "no bodies": (lambda d: d.update(bodies=[]), "bodies must hold"),
    "a list is needed": (lambda d: d.update(bodies={}), "bodies must be a list"),
    "unknown field": (lambda d: d.update(colour="red"), "unknown field colour"),
    "unknown shape": (lambda d: d["bodies"][0].update(shape="cube"), "unknown shape 'cube'"),
    "unknown parameter": (lambda d: d["bodies"][0]["parameters"].update(radios=1), "has no radios"),
    "text for a number": (lambda d: d["bodies"][0].update(yaw="north"), "yaw must be float"),
    "negative radius": (lambda d: d["bodies"][0]["parameters"].update(radius=-1.0), "roll radius"),
    "radius as text": (lambda d: d["bodies"][0]["parameters"].update(radius="big"), "roll radius"),
    "outside the table": (lambda d: d["bodies"][0].update(position=[0.3, 0]), "must stay within"),
    "overlap": (lambda d: d["bodies"].append(d["bodies"][0]), "overlap"),
    "liquid": (lambda d: d.update(material={"poisson_ratio": 0.5}), "poisson_ratio"),
    "opens": (lambda d: d["actions"][0].update(opening_end=0.2), "opening_end"),
    "starts inside": (
        lambda d: d["actions"][0].update(opening_start=0.010, opening_end=0.005),
        "starts inside",
    ),
    "unknown tool": (lambda d: d.update(tools=["spoon"]), "unknown tool 'spoon'"),
    "tool index": (lambda d: d["actions"][0].update(tool=5), "tool must be 0..0"),
    "newer major": (lambda d: d.update(schema_version="2.0"), "schema_version"),
    "missing mesh": (lambda d: d["tools"].__setitem__(0, {"name": "x", "mesh": "no.stl"}), None),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_scene_is_refused_in_one_line(what: str) -> None:
    """Every wrong field is named in one line; nothing else escapes."""
    damage, message = BROKEN[what]
    data = json.loads(json.dumps(valid()))
    damage(data)
    with pytest.raises((SceneError, UnknownNameError)) as caught:
        finger_mesh(scene_from_json(data).tools[0])  # a mesh file is opened when it is needed
    assert "\n" not in str(caught.value)
    if message:
        assert message in str(caught.value)


def test_a_list_of_scenes_is_read(tmp_path) -> None:
    """A JSON file may hold one scene or a list; doubled ids and non-JSON are refused."""
    file = tmp_path / "mine.json"
    file.write_text(json.dumps([valid(), {**valid(), "scene_id": "b"}]))
    assert [scene.scene_id for scene in read_scenes(file)][1] == "b"
    file.write_text(json.dumps([valid(), valid()]))
    with pytest.raises(SceneError, match="more than once"):
        read_scenes(file)
    file.write_text("{")
    with pytest.raises(SceneError, match="not JSON"):
        read_scenes(file)


def test_a_minimal_scene_is_enough() -> None:
    """Defaults fill everything but bodies, tools and actions."""
    scene = scene_from_json(
        {"bodies": [{"shape": "roll"}], "tools": ["narrow"], "actions": [{}]}, name="mine"
    )
    assert (scene.scene_id, scene.family, scene.region) == ("mine", "custom", "custom")
    assert scene.tools == (PRESETS["narrow"],)
    assert check_scene(scene) is scene


def test_a_ring_without_a_hole_is_refused() -> None:
    """A tube as thick as its ring leaves no hole, so the genus would be wrong."""
    with pytest.raises(SceneError, match="needs a hole"):
        shape_of(Body(shape="ring", parameters={"ring_radius": 0.01, "tube_radius": 0.012}))


def test_an_open_mesh_is_no_tool(tmp_path) -> None:
    """A finger must be watertight."""
    mesh = finger_mesh(PRESETS["regular"])
    mesh.update_faces([True] * (len(mesh.faces) - 1) + [False])
    mesh.export(tmp_path / "open.stl")
    with pytest.raises(SceneError, match="watertight"):
        finger_mesh(Tool(name="x", mesh=str(tmp_path / "open.stl")))
