"""The gripper that a planner squeezes with: tools by name, moved as the simulator moves them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64

from doughcli.net_sources import Source
from doughdata.dataset import FrameTools
from doughdata.geometry import transform_points
from doughdata.scenes.limits import inside_finger, surface_points
from doughdata.scenes.tools import finger_poses, opening_at
from doughdata.torch.sampling import tool_points
from doughnet.model import DoughNet
from doughnet.planner import reconstructed
from doughschemas import Action, Tool

__all__ = ["ToolGripper", "dough_at_start"]

NUM_POINTS = 128  # a finger, as in training


class ToolGripper:
    """A `doughnet.planner.Gripper` of real tools.

    Args:
        tools: to choose from, by name.
        template: action whose speed, first opening and share of holding a plan keeps.
        frames: key frames that the model steps through.
        num_frames: key frames of a scene.
        dough: points [m], world, (N, 3), in which no finger may begin.
        seed: of the points on the fingers, which are the same for every squeeze.
    """

    def __init__(
        self,
        tools: Mapping[str, Tool],
        template: Action,
        *,
        frames: Sequence[int],
        num_frames: int,
        dough: Float64[np.ndarray, "N 3"],
        seed: int = 0,
    ) -> None:
        self._tools, self._template = dict(tools), template
        self._frames, self._num_frames = tuple(frames), num_frames
        self._dough = dough
        rng = np.random.default_rng(seed)
        self._local = {name: _in_finger_frame(tool, rng) for name, tool in self._tools.items()}

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools."""
        return tuple(self._tools)

    def tool(self, name: str) -> Tool:
        """The tool of a name."""
        return self._tools[name]

    def action(self, squeeze: Any) -> Action:
        """The action that makes a `doughnet.search.Squeeze`."""
        before = self._template
        action = replace(
            before,
            tool=0,
            position=squeeze.position,
            yaw=squeeze.yaw,
            opening_end=min(squeeze.opening, before.opening_start),
            hold=0.0,
        )
        share = before.hold / before.duration
        return replace(action, hold=action.duration * share / (1.0 - share))

    def poses(self, squeeze: Any) -> list[FrameTools]:
        """Both fingers in every key frame that the model steps through."""
        action, found = self.action(squeeze), []
        times = np.linspace(0.0, action.duration, self._num_frames)
        for time in times[list(self._frames)]:
            opening, _ = opening_at(action, float(time))
            position, quaternion = finger_poses(action, opening)
            found.append(
                FrameTools(
                    tool=self._tools[squeeze.tool],
                    action=0,
                    position=position,
                    quaternion=quaternion,
                    opening=opening,
                )
            )
        return found

    def points(
        self, squeezes: Sequence[Any]
    ) -> Float32[np.ndarray, "squeezes frames fingers points 3"]:
        """Points [m], world, on the fingers in every key frame."""
        return np.array(
            [
                [
                    [
                        transform_points(self._local[squeeze.tool], p, q)
                        for p, q in zip(tools.position, tools.quaternion, strict=True)
                    ]
                    for tools in self.poses(squeeze)
                ]
                for squeeze in squeezes
            ],
            np.float32,
        )

    def free(self, squeezes: Sequence[Any]) -> Bool[np.ndarray, " squeezes"]:
        """Whether the fingers begin beside the dough, not in it."""
        return np.array([not self._begins_inside(squeeze) for squeeze in squeezes], bool)

    def _begins_inside(self, squeeze: Any) -> bool:
        tool = self._tools[squeeze.tool]
        if tool.mesh is not None:
            return False  # as `check_scene` has it: only the fingers of a box are looked at
        return inside_finger(self.action(squeeze), tool.depth, tool.width, self._dough)


def dough_at_start(start: Source, model: DoughNet) -> Float64[np.ndarray, "N 3"]:
    """Where dough is when a plan begins, as `doughcli.net_trial.planned_scene` puts it there.

    That of a simulated start is known; of a recording the model tells.
    """
    if start.scene is not None:
        return np.concatenate([surface_points(body) for body in start.scene.bodies])
    return reconstructed(model, (start.points, start.labels))


def _in_finger_frame(tool: Tool, rng: np.random.Generator) -> Any:
    still = FrameTools(
        tool=tool,
        action=0,
        position=np.zeros((1, 3)),
        quaternion=np.array([[0.0, 0.0, 0.0, 1.0]]),
        opening=0.0,
    )
    return tool_points(still, NUM_POINTS, rng)[0]
