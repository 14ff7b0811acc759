"""Where the fingers are in one key frame, and how far particles are from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.scenes.sdf import SignedDistanceGrid, finger_sdf
from doughschemas import Scene, ToolPoses

__all__ = ["Gripper", "gripper_at"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gripper:
    """Both fingers of a key frame."""

    position: Float64[np.ndarray, "fingers 3"]  # [m], world
    rotation: Float64[np.ndarray, "fingers 3 3"]  # finger frame -> world
    shape: SignedDistanceGrid

    @property
    def closing(self) -> Float64[np.ndarray, " 3"]:
        """Unit vector along which the fingers close."""
        return self.rotation[0][:, 0]

    @property
    def lateral(self) -> Float64[np.ndarray, " 3"]:
        """Unit vector across the closing axis, in the table's plane."""
        return self.rotation[0][:, 1]

    def distances(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> Float64[np.ndarray, "fingers points"]:
        """Signed distance [m] of each point to each finger; negative inside."""
        local = [(points - p) @ r for p, r in zip(self.position, self.rotation, strict=True)]
        return np.stack([self.shape.sample(part) for part in local])

    def near(
        self, points: Float64[np.ndarray, "points 3"], reach: float
    ) -> Bool[np.ndarray, " points"]:
        """Whether each point is closer than `reach` [m] to a finger."""
        low = self.shape.origin
        high = low + self.shape.spacing * (np.array(self.shape.values.shape) - 1)
        found = np.zeros(len(points), dtype=bool)
        for position, rotation in zip(self.position, self.rotation, strict=True):
            local = (points - position) @ rotation
            box = np.flatnonzero(((local > low - reach) & (local < high + reach)).all(axis=1))
            found[box] |= self.shape.sample(local[box]) < reach
        return found

    def between(
        self,
        points: Float64[np.ndarray, "points 3"],
        ends: Float64[np.ndarray, "points 3"],
        depth: float,
    ) -> Bool[np.ndarray, " points"]:
        """Whether a finger lies at least `depth` [m] deep between each point and its end.

        Three samples a segment: bonds are at most three spacings long, fingers two or more wide.
        """
        through = np.zeros(len(points), dtype=bool)
        # A distance changes by at most the way walked: most segments are settled by their middle.
        reach = 0.2 * np.linalg.norm(ends - points, axis=1)
        middle = self.distances((points + ends) / 2).min(axis=0)
        through |= middle < -depth
        undecided = np.flatnonzero(~through & (middle < reach - depth))
        for share in (0.3, 0.7):
            samples = points[undecided] + share * (ends[undecided] - points[undecided])
            through[undecided] |= self.distances(samples).min(axis=0) < -depth
        return through


def gripper_at(scene: Scene, poses: ToolPoses, frame: int) -> Gripper:
    """The fingers of one key frame.

    Raises:
        SceneError: the tool's mesh cannot be used.
    """
    tool = scene.tools[scene.actions[int(poses.action[frame])].tool]
    rotation = np.stack([_rotation(q) for q in poses.quaternion[frame]])
    return Gripper(position=poses.position[frame], rotation=rotation, shape=finger_sdf(tool))


def _rotation(quaternion: Float64[np.ndarray, " 4"]) -> Float64[np.ndarray, "3 3"]:
    """Matrix of a unit quaternion (xyzw)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
