"""Round trips of scenes."""

import json

from hypothesis import given, settings

from doughdata.scenes import check_scene, scene_from_json, scene_to_json
from doughdata.testing import scenes
from doughschemas import Scene


@settings(max_examples=40, deadline=None)
@given(scenes())
def test_json_brings_a_scene_back_equal(scene: Scene) -> None:
    """Writing a scene as JSON text and reading it gives an equal record."""
    assert scene_from_json(json.loads(json.dumps(scene_to_json(scene)))) == scene


@settings(max_examples=40, deadline=None)
@given(scenes())
def test_the_shipped_strategy_draws_valid_scenes(scene: Scene) -> None:
    """Whatever the strategy draws, the physical limits accept it as it is."""
    assert check_scene(scene) is scene
