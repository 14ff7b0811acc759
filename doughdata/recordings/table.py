"""The table in a depth image, and the world that stands on it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from doughdata.geometry import matrix_to_quaternion, pixel_rays
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import ProcessingConfig
from doughdata.registry import require_package
from doughschemas import Camera, Intrinsics

__all__ = ["Plane", "camera_points", "fit_table", "world_camera"]

FEWEST = 500  # pixels that a table must have
LEAST_SHARE = 0.10  # of the valid pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """normal . point + offset = height above the table [m], in the optical frame."""

    normal: Float64[np.ndarray, " 3"]  # unit, towards the camera
    offset: float  # [m], the camera's height
    share: float  # of the valid pixels, within `plane_distance`
    residual: float  # [m], root mean square of those

    def heights(self, points: Float[np.ndarray, "*image 3"]) -> Float64[np.ndarray, "*image"]:
        """Heights [m] of points [m]."""
        return np.asarray(points @ self.normal + self.offset)


def camera_points(
    depth: Float[np.ndarray, "rows columns"], intrinsics: Intrinsics
) -> Float64[np.ndarray, "rows columns 3"]:
    """Points [m] of a depth image [m], optical frame; pixels of depth 0 are at the origin."""
    return pixel_rays(intrinsics) * depth[..., None]


def fit_table(
    points: Float64[np.ndarray, "rows columns 3"],
    valid: Bool[np.ndarray, "rows columns"],
    config: ProcessingConfig,
) -> Plane:
    """The largest plane: RANSAC on a regular choice of pixels, then least squares on its pixels.

    Raises:
        RecordingError: no plane is large enough, or the camera looks along it.
    """
    o3d = require_package("open3d", extra="render")
    cloud = points[valid]
    few = cloud[:: max(1, len(cloud) // config.plane_points)]
    if len(few) < 3:
        raise RecordingError(f"no table: the first image has {len(cloud)} valid pixels")
    o3d.utility.random.seed(0)  # the same recording gives the same plane
    found, _ = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(few)).segment_plane(
        config.plane_distance, 3, config.plane_draws
    )
    normal, offset = np.array(found[:3], float), float(found[3])
    length = np.linalg.norm(normal)
    normal, offset = normal / length, offset / length
    near = cloud
    for _ in range(3):
        near = cloud[np.abs(cloud @ normal + offset) < config.plane_distance]
        if len(near) < max(FEWEST, LEAST_SHARE * len(cloud)):
            raise RecordingError(
                f"no table: the largest plane has {len(near)} of {len(cloud)} valid pixels "
                f"within {config.plane_distance * 1e3:g} mm; --option plane_distance=0.008 is laxer"
            )
        middle = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov((near - middle).T))[1][:, 0]
        offset = -float(normal @ middle)
    if offset < 0:
        normal, offset = -normal, -offset
    residual = float(np.sqrt(np.mean((near @ normal + offset) ** 2)))
    if offset < 0.02:
        raise RecordingError("no table: the largest plane goes through the camera")
    return Plane(
        normal=normal, offset=float(offset), share=len(near) / len(cloud), residual=residual
    )


def world_camera(
    intrinsics: Intrinsics,
    plane: Plane,
    origin: Float[np.ndarray, " 3"],
    turn: float,
) -> Camera:
    """The camera's pose in a world with z up and the table at z = 0.

    `origin` is a point [m] of the optical frame that lies above the world's origin. With `turn`
    [rad] = 0 world x is the picture's left along the table, which puts the camera on the side of
    positive y, as the simulated one; a positive turn rotates the world's axes about z.
    """
    up = plane.normal
    left = np.array([-1.0, 0.0, 0.0])
    x = left - up * (left @ up)
    if np.linalg.norm(x) < 1e-6:  # the picture's rows run along the table's normal
        x = np.array([0.0, -1.0, 0.0]) - up * -up[1]
    x /= np.linalg.norm(x)
    y = np.cross(up, x)
    x, y = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    rotation = np.stack([x, y, up])  # optical frame -> world
    foot = origin - up * plane.heights(origin)
    px, py, pz = (float(v) for v in -rotation @ foot)
    qx, qy, qz, qw = (float(v) for v in matrix_to_quaternion(rotation))
    return Camera(intrinsics=intrinsics, position=(px, py, pz), quaternion=(qx, qy, qz, qw))
