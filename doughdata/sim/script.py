"""What happens to the dough of a scene, stretch by stretch: the same for one scene and for many."""

from collections.abc import Generator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from doughdata.scenes.sdf import MARGIN, SignedDistanceGrid, finger_sdf
from doughdata.scenes.tools import finger_poses, opening_at
from doughdata.sim.solver import Solver, Squeeze
from doughschemas import Action, Scene, SimulationError, ToolPoses

__all__ = ["Stretch", "play", "tool_poses"]

SET_DOWN = 0.25  # [cells]; a finger that is set down this deep in dough ends the scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """How a cloud moves for a while: fingers change their opening linearly, or there are none."""

    seconds: float
    squeeze: Squeeze | None = None
    steps: int | None = None  # overrides the number that the CFL limit asks for


def play(
    scene: Scene,
    cloud: Solver,
    timestamps: Float64[np.ndarray, " frames"],
    *,
    settle: float,
    rest: float,
) -> Generator[Stretch, None, list[np.ndarray]]:
    """Stretches of a scene, each asked for when the one before was made; then the key frames [m].

    `settle` [s] passes before the first key frame. Dough slower than `rest` [m/s] sleeps while no
    finger is near.

    Raises:
        SceneError: a tool's mesh cannot be used.
        SimulationError: a finger would be set down inside dough.
    """
    tools = [finger_sdf(tool) for tool in scene.tools]
    if settle > 0:
        yield Stretch(seconds=settle)
    frames, under_way = [cloud.positions], -1
    for begin, end in pairwise(timestamps):
        for a, b in pairwise(_breaks(scene, begin, end)):
            squeeze = _squeeze(scene, tools, a, b)
            index, _ = _action_at(scene, (a + b) / 2)
            if index != under_way:  # lifted off and set down somewhere else
                _check_set_down(cloud, squeeze, index)
                under_way = index
            if _within_reach(cloud, squeeze, b - a):
                yield Stretch(seconds=b - a, squeeze=squeeze)
            elif float(np.abs(cloud.v).max()) > rest:
                yield Stretch(seconds=b - a)
        frames.append(cloud.positions)
    return frames


def _check_set_down(cloud: Solver, squeeze: Squeeze, action: int) -> None:
    """Refuse fingers that would begin inside dough: they would fling it away."""
    depth = SET_DOWN * cloud.physics.dx
    for finger, local in enumerate(_in_finger_frames(cloud, squeeze)):
        distance = squeeze.sdf.sample(local)
        if distance.min() < -depth:
            where = ", ".join(f"{value:.3f}" for value in cloud.x[distance.argmin()])
            raise SimulationError(
                f"action {action}: finger {finger} would start inside the dough at ({where}) "
                "m; widen opening_start or move it"
            )


def tool_poses(scene: Scene, timestamps: Float64[np.ndarray, " frames"]) -> ToolPoses:
    """Where both fingers are at each time [s]."""
    position, quaternion, opening, number = [], [], [], []
    for time in timestamps:
        index, begin = _action_at(scene, time)
        gap, _ = opening_at(scene.actions[index], time - begin)
        p, q = finger_poses(scene.actions[index], gap)
        position.append(p)
        quaternion.append(q)
        opening.append(gap)
        number.append(index)
    return ToolPoses(
        position=np.array(position),
        quaternion=np.array(quaternion),
        opening=np.array(opening),
        action=np.array(number, np.int32),
    )


def _action_at(scene: Scene, time: float) -> tuple[int, float]:
    """Index of the action under way, and when it began [s]; the last one at the very end."""
    begin = 0.0
    for index, action in enumerate(scene.actions):
        if time < begin + action.duration or index == len(scene.actions) - 1:
            return index, begin
        begin += action.duration
    raise SimulationError("a scene needs an action")


def _breaks(scene: Scene, begin: float, end: float) -> list[float]:
    """Times from `begin` to `end` [s] between which no finger changes its speed."""
    times, offset = [begin], 0.0
    for action in scene.actions:
        turns = [offset + turn for turn in _turns(action)]
        times.extend(turn for turn in turns if begin + 1e-9 < turn < end - 1e-9)
        offset += action.duration
    return [*times, end]


def _turns(action: Action) -> list[float]:
    """When a finger changes its speed, from the start of its action [s]."""
    close = (action.opening_start - action.opening_end) / (2 * action.speed)
    return sorted({close, close + action.hold, action.duration})


def _squeeze(scene: Scene, tools: list[SignedDistanceGrid], begin: float, end: float) -> Squeeze:
    index, offset = _action_at(scene, (begin + end) / 2)
    action = scene.actions[index]
    middle, speed = opening_at(action, (begin + end) / 2 - offset)
    return Squeeze(
        sdf=tools[action.tool],
        position=action.position,
        yaw=action.yaw,
        opening=middle + speed * (end - begin),
        rate=-2.0 * speed,
        friction=scene.tools[action.tool].friction,
    )


def _within_reach(solver: Solver, squeeze: Squeeze, seconds: float) -> bool:
    """Whether a finger's box, grown by the kernel support and its travel, holds a particle."""
    grow = 3.0 * solver.physics.dx + 0.5 * abs(squeeze.rate) * seconds
    size = (np.array(squeeze.sdf.values.shape) - 1) * squeeze.sdf.spacing
    low = squeeze.sdf.origin + MARGIN - grow
    high = squeeze.sdf.origin + size - MARGIN + grow
    return any(
        bool(((local > low) & (local < high)).all(axis=1).any())
        for local in _in_finger_frames(solver, squeeze)
    )


def _in_finger_frames(solver: Solver, squeeze: Squeeze) -> list[Float64[np.ndarray, "particles 3"]]:
    """Particles [m] in the frames of finger 0 and finger 1 at the start of a stretch."""
    c, s = np.cos(squeeze.yaw), np.sin(squeeze.yaw)
    r = solver.x[:, :2] - np.array(squeeze.position)
    along, lateral = c * r[:, 0] + s * r[:, 1], c * r[:, 1] - s * r[:, 0]
    return [
        np.stack([side * along - squeeze.opening / 2, side * lateral, solver.x[:, 2]], axis=1)
        for side in (1.0, -1.0)
    ]
