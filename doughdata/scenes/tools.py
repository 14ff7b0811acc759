"""Gripper fingers: presets, solid meshes and poses."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from doughdata.registry import require_package
from doughschemas import Action, SceneError, Tool, UnknownNameError

if TYPE_CHECKING:
    import trimesh

__all__ = ["PRESETS", "finger_mesh", "finger_poses", "opening_at", "tool_preset"]

# Depth (closing axis) x width of the authors' fingers, in SI (`SPEC.md`, "Tools").
PRESETS = {
    "narrow": Tool(name="narrow", depth=0.020, width=0.003),
    "regular": Tool(name="regular", depth=0.010, width=0.010),
    "wide": Tool(name="wide", depth=0.003, width=0.100),
}


def tool_preset(name: str) -> Tool:
    """A named finger.

    Raises:
        UnknownNameError: no such preset.
    """
    if name not in PRESETS:
        raise UnknownNameError("tool", name, PRESETS)
    return PRESETS[name]


def finger_mesh(tool: Tool) -> "trimesh.Trimesh":
    """Closed mesh of one finger [m], in the finger frame (face at x = 0, lowest point z = 0).

    Raises:
        SceneError: the file is missing, no mesh, or not watertight.
    """
    trimesh = require_package("trimesh", extra="sim")
    if tool.mesh is None:
        box = trimesh.creation.box(extents=[tool.depth, tool.width, tool.height])
        box.apply_translation([tool.depth / 2, 0.0, tool.height / 2])
        return box
    path = Path(tool.mesh)
    if not path.is_file():
        raise SceneError(f"tool {tool.name!r}: mesh file {tool.mesh!r} not found")
    try:
        mesh = trimesh.load(path, force="mesh")
    except Exception as error:  # every loader has its own exceptions
        raise SceneError(f"tool {tool.name!r}: cannot read {tool.mesh!r}: {error}") from error
    mesh.apply_scale(tool.scale)
    if len(mesh.faces) == 0 or not mesh.is_watertight:
        raise SceneError(f"tool {tool.name!r}: mesh {tool.mesh!r} must be watertight")
    return mesh


def opening_at(action: Action, time: float) -> tuple[float, float]:
    """Opening [m] and closing speed [m/s] of each finger (negative = opening) at a time [s]."""
    close = (action.opening_start - action.opening_end) / (2 * action.speed)
    if time < close:
        return action.opening_start - 2 * action.speed * time, action.speed
    if time <= close + action.hold or not action.release:
        return action.opening_end, 0.0
    opened = action.opening_end + 2 * action.speed * (time - close - action.hold)
    if opened >= action.opening_start:
        return action.opening_start, 0.0
    return opened, -action.speed


def finger_poses(
    action: Action, opening: float
) -> tuple[Float64[np.ndarray, "2 3"], Float64[np.ndarray, "2 4"]]:
    """Position [m] and quaternion (xyzw) of both finger frames in the world.

    Finger 0 lies on the positive side of the closing axis, finger 1 is the same turned by pi.
    """
    x, y = action.position
    yaws = np.array([action.yaw, action.yaw + np.pi])
    axis = np.stack([np.cos(yaws), np.sin(yaws), np.zeros(2)], axis=1)
    position = np.array([x, y, 0.0]) + axis * (opening / 2)
    quaternion = np.zeros((2, 4))
    quaternion[:, 2], quaternion[:, 3] = np.sin(yaws / 2), np.cos(yaws / 2)
    return position, quaternion
