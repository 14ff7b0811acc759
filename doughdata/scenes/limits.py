"""Physical limits: what a scene must satisfy before anything is simulated."""

from itertools import permutations

import numpy as np
from jaxtyping import Float64

from doughdata.scenes.shapes import shape_of
from doughdata.scenes.shapes.base import require_range
from doughschemas import Action, Body, Scene, SceneError

__all__ = ["WORKSPACE", "check_scene", "inside_finger", "surface_points"]

WORKSPACE = 0.100  # [m], half the side of the square that bodies and gaps stay in
MOST_YAW = 100.0  # [rad]; any turn, but no NaN and nothing that sine and cosine lose
SAMPLE = 0.002  # [m], grid on which clearances are checked


def check_scene(scene: Scene) -> Scene:
    """Return the scene if it can be simulated.

    Raises:
        SceneError: one line naming the scene, the field, the limit and the value.
    """
    try:
        _check(scene)
    except SceneError as error:
        raise SceneError(f"scene {scene.scene_id!r}: {error}") from error
    return scene


def _check(scene: Scene) -> None:
    for what in ("bodies", "tools", "actions"):
        if not getattr(scene, what):
            raise SceneError(f"{what} must hold at least one entry")
    if len(scene.bodies) > 200:
        raise SceneError(f"at most 200 bodies, got {len(scene.bodies)}")
    if scene.split not in ("train", "test"):
        raise SceneError(f"split must be train or test, got {scene.split!r}")
    material = scene.material
    require_range("young_modulus", material.young_modulus, 1e3, 1e6, unit="Pa")
    require_range("poisson_ratio", material.poisson_ratio, 0.0, 0.48, unit="")
    require_range("density", material.density, 100.0, 5000.0, unit="kg/m3")
    require_range("yield_stress", material.yield_stress, 10.0, 1e9, unit="Pa")
    require_range("table_friction", scene.table_friction, 0.0, 10.0, unit="")
    for tool in scene.tools:
        require_range("tool friction", tool.friction, 0.0, 10.0, unit="")
        require_range("tool scale", tool.scale, 1e-9, 1e3, unit="m per mesh unit")
        if tool.mesh is None:
            for what in ("depth", "width", "height"):
                require_range(f"tool {what}", getattr(tool, what), 0.001, 0.200)
    for number, body in enumerate(scene.bodies):
        require_range(f"body {number}: yaw", body.yaw, -MOST_YAW, MOST_YAW, unit="rad")
        for axis in (0, 1):  # loosely: how far its dough reaches is checked below
            require_range(f"body {number}: position", body.position[axis], -1.0, 1.0)
    clouds = [surface_points(body) for body in scene.bodies]
    for body, cloud in zip(scene.bodies, clouds, strict=True):
        reach = float(np.abs(cloud[:, :2]).max())
        if reach > WORKSPACE:
            raise SceneError(
                f"body {body.shape!r} must stay within {WORKSPACE} m of the origin, "
                f"reaches {reach:.3f}"
            )
    _check_apart(scene.bodies, clouds)
    for number, action in enumerate(scene.actions):
        _check_action(scene, number, action, clouds if number == 0 else [])


def _check_action(
    scene: Scene, number: int, action: Action, clouds: list[Float64[np.ndarray, "_ 3"]]
) -> None:
    if not 0 <= action.tool < len(scene.tools):
        raise SceneError(
            f"action {number}: tool must be 0..{len(scene.tools) - 1}, got {action.tool}"
        )
    require_range(f"action {number}: speed", action.speed, 0.001, 0.3, unit="m/s")
    require_range(f"action {number}: hold", action.hold, 0.0, 60.0, unit="s")
    require_range(f"action {number}: opening_start", action.opening_start, 0.002, 0.180)
    require_range(f"action {number}: opening_end", action.opening_end, 0.0005, action.opening_start)
    require_range(f"action {number}: yaw", action.yaw, -MOST_YAW, MOST_YAW, unit="rad")
    for axis in (0, 1):
        require_range(f"action {number}: position", action.position[axis], -WORKSPACE, WORKSPACE)
    tool = scene.tools[action.tool]
    if tool.mesh is None and any(inside_finger(action, tool.depth, tool.width, c) for c in clouds):
        raise SceneError(
            f"action {number}: a finger starts inside a body; widen opening_start or move it"
        )


def inside_finger(
    action: Action, depth: float, width: float, points: Float64[np.ndarray, "points 3"]
) -> bool:
    """Whether a point [m] lies in a box finger at the start of an action (1 mm margin)."""
    x, y = (points[:, :2] - np.asarray(action.position)).T
    across = x * np.cos(action.yaw) + y * np.sin(action.yaw)
    along = y * np.cos(action.yaw) - x * np.sin(action.yaw)
    start = action.opening_start / 2 - 0.001
    hit = (np.abs(along) < width / 2 + 0.001) & (np.abs(across) > start)
    return bool((hit & (np.abs(across) < start + depth + 0.002)).any())


def surface_points(body: Body, *, spacing: float = SAMPLE) -> Float64[np.ndarray, "points 3"]:
    """Grid points [m] of a body, in the world: enough to check reach and clearance.

    Raises:
        SceneError: the body is too small to hold a point, or outside its limits.
    """
    shape = shape_of(body)
    low, high = shape.bounds()
    axes = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[shape.contains(grid)]
    if len(grid) == 0:
        raise SceneError(f"body {body.shape!r} is smaller than {spacing} m")
    return to_world(grid, body)


def to_world(
    points: Float64[np.ndarray, "points 3"], body: Body
) -> Float64[np.ndarray, "points 3"]:
    """From a shape's own frame to the world [m]."""
    c, s = np.cos(body.yaw), np.sin(body.yaw)
    turned = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned + np.array([*body.position, 0.0])


def to_body(points: Float64[np.ndarray, "points 3"], body: Body) -> Float64[np.ndarray, "points 3"]:
    """From the world to a shape's own frame [m]."""
    c, s = np.cos(body.yaw), np.sin(body.yaw)
    return (points - np.array([*body.position, 0.0])) @ np.array(
        [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    )


def _check_apart(bodies: tuple[Body, ...], clouds: list[Float64[np.ndarray, "_ 3"]]) -> None:
    shapes = [shape_of(body) for body in bodies]
    for first, second in permutations(range(len(bodies)), 2):
        if shapes[second].contains(to_body(clouds[first], bodies[second])).any():
            raise SceneError(f"bodies {min(first, second)} and {max(first, second)} overlap")
