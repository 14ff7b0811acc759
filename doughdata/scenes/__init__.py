"""Scenes: families to sample from, shapes, tools, and plain JSON in and out."""

from doughdata.scenes.families import FamilyName, load_family
from doughdata.scenes.json import read_scenes, scene_from_json, scene_to_json
from doughdata.scenes.limits import check_scene
from doughdata.scenes.materials import MATERIALS, SAMPLED, material_preset, sample_material
from doughdata.scenes.shapes import shape_of
from doughdata.scenes.shapes.mesh import body_mesh
from doughdata.scenes.tools import (
    PRESETS,
    finger_mesh,
    finger_poses,
    opening_at,
    tool_preset,
)

__all__ = [
    "MATERIALS",
    "PRESETS",
    "SAMPLED",
    "FamilyName",
    "body_mesh",
    "check_scene",
    "finger_mesh",
    "finger_poses",
    "load_family",
    "material_preset",
    "opening_at",
    "read_scenes",
    "sample_material",
    "scene_from_json",
    "scene_to_json",
    "shape_of",
    "tool_preset",
]
