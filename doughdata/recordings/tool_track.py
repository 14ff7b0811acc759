"""Where the gripper was at each key frame, from tf, in the world that stands on the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from doughdata.geometry import matrix_to_quaternion, quaternion_to_matrix
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.source import Source
from doughdata.recordings.transforms import read_transforms
from doughschemas import Camera

__all__ = ["ToolTrack", "tool_track"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolTrack:
    """Poses of the tool frame in the world."""

    frames: tuple[int, ...]  # key frames in which it is known
    position: Float64[np.ndarray, "poses 3"]  # [m]
    quaternion: Float64[np.ndarray, "poses 4"]  # xyzw, tool frame -> world


def tool_track(
    source: Source,
    options: TopicOptions,
    camera_frame: str,
    camera: Camera,
    stamps: Sequence[int],
) -> ToolTrack:
    """Pose of `options.tool_frame` at each stamp [ns]; nothing if no frame was named.

    Raises:
        RecordingError: tf does not connect that frame with the camera's at any key frame.
    """
    frames, positions, quaternions = [], [], []
    if options.tool_frame is not None:
        tree = read_transforms(source)
        to_world = np.eye(4)
        to_world[:3, :3] = quaternion_to_matrix(np.array(camera.quaternion))
        to_world[:3, 3] = camera.position
        for number, stamp in enumerate(stamps):
            pose = tree.pose(options.tool_frame.lstrip("/"), camera_frame, stamp)
            if pose is None:
                continue
            world = to_world @ pose
            frames.append(number)
            positions.append(world[:3, 3])
            quaternions.append(matrix_to_quaternion(world[:3, :3]))
        if not frames:
            raise RecordingError(
                f"--tool-frame: tf never connects {options.tool_frame!r} with the camera's frame "
                f"{camera_frame!r}"
            )
    return ToolTrack(
        frames=tuple(frames),
        position=np.array(positions, float).reshape(-1, 3),
        quaternion=np.array(quaternions, float).reshape(-1, 4),
    )
