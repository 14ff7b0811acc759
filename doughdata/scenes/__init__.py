"""Scenes: families to sample from, shapes, tools, and plain JSON in and out."""

from doughdata.scenes.json import read_scenes, scene_from_json, scene_to_json
from doughdata.scenes.limits import check_scene
from doughdata.scenes.shapes import shape_of
from doughdata.scenes.tools import (
    PRESETS,
    finger_mesh,
    finger_poses,
    opening_at,
    tool_preset,
)

__all__ = [
    "PRESETS",
    "check_scene",
    "finger_mesh",
    "finger_poses",
    "opening_at",
    "read_scenes",
    "scene_from_json",
    "scene_to_json",
    "shape_of",
    "tool_preset",
]
