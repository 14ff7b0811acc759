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
        return np.stack([self._to(finger, points) for finger in range(len(self.position))])

    def distances_within(
        self, points: Float64[np.ndarray, "points 3"], reach: float, *, raised: float
    ) -> Float64[np.ndarray, "fingers points"]:
        """As `distances`, but infinite for points farther than `reach` [m] from the finger's grid.

        Cheap where most points are far from the fingers. Points less than `raised` [m] above a
        finger's foot are taken for points at that height: nothing passes below a finger that
        stands on the table, but its foot is a face, and no point near a face is deep inside.
        """
        low = self.shape.origin
        high = low + self.shape.spacing * (np.array(self.shape.values.shape) - 1)
        found = np.full((len(self.position), len(points)), np.inf)
        for own, position, rotation in zip(found, self.position, self.rotation, strict=True):
            local = (points - position) @ rotation
            box = np.flatnonzero(((local > low - reach) & (local < high + reach)).all(axis=1))
            own[box] = self._sample(local[box], raised)
        return found

    def between(
        self,
        points: Float64[np.ndarray, "points 3"],
        ends: Float64[np.ndarray, "points 3"],
        depth: float,
        *,
        distances: Float64[np.ndarray, "fingers points 2"],
    ) -> Bool[np.ndarray, " points"]:
        """Whether a finger lies at least `depth` [m] deep between each point and its end.

        `distances` are those of each point and of its end to each finger, raised by `2 depth`.
        Three samples a segment: bonds are at most three spacings long, fingers two or more wide.
        """
        raised = 2 * depth
        length = np.linalg.norm(ends - points, axis=1)
        through = np.zeros(len(points), dtype=bool)
        for finger in range(len(self.position)):
            # A distance changes by at most the way walked: few segments can reach so deep.
            deepest = (distances[finger].sum(axis=1) - length) / 2
            asked = np.flatnonzero(~through & (deepest < -depth))
            middle = self._to(finger, (points[asked] + ends[asked]) / 2, raised)
            through[asked] |= middle < -depth
            asked = asked[(middle >= -depth) & (middle < 0.2 * length[asked] - depth)]
            for share in (0.3, 0.7):
                samples = points[asked] + share * (ends[asked] - points[asked])
                through[asked] |= self._to(finger, samples, raised) < -depth
        return through

    def _to(
        self, finger: int, points: Float64[np.ndarray, "points 3"], raised: float = -np.inf
    ) -> Float64[np.ndarray, " points"]:
        return self._sample((points - self.position[finger]) @ self.rotation[finger], raised)

    def _sample(
        self, local: Float64[np.ndarray, "points 3"], raised: float
    ) -> Float64[np.ndarray, " points"]:
        lifted = np.column_stack([local[:, :2], np.maximum(local[:, 2], raised)])
        return self.shape.sample(lifted)


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
