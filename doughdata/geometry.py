"""Rotations and pinhole geometry in plain numpy; every part may import this.

Quaternions are xyzw. Camera frame: optical (x right, y down, z forward); depth is along z. Pixel
(0, 0) has its centre at (0, 0).
"""

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from doughschemas import Camera, Intrinsics

__all__ = [
    "matrix_to_quaternion",
    "pixel_rays",
    "points_from_depth",
    "project",
    "quaternion_to_matrix",
    "rotation_vector_to_matrix",
    "transform_points",
    "unproject",
]


def quaternion_to_matrix(quaternion: Float[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "..."]:
    """Rotation matrices (*batch, 3, 3) of quaternions (xyzw), which are normalised first.

    Raises:
        ValueError: a quaternion of length zero.
    """
    quaternion = np.asarray(quaternion, float)
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    if np.any(length == 0):
        raise ValueError("a quaternion of length zero is no rotation")
    x, y, z, w = np.moveaxis(quaternion / length, -1, 0)
    entries = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack(entries, axis=-1).reshape(*quaternion.shape[:-1], 3, 3)


def matrix_to_quaternion(matrix: Float[np.ndarray, "3 3"]) -> Float64[np.ndarray, " 4"]:
    """Unit quaternion (xyzw, w >= 0) of a rotation matrix.

    It is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix (2000), which
    is well-conditioned for every angle.
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(matrix, float)
    symmetric = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    quaternion = np.linalg.eigh(symmetric)[1][:, -1]
    return -quaternion if quaternion[3] < 0 else quaternion


def rotation_vector_to_matrix(vector: Float[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation by |vector| [rad] about the vector's direction."""
    vector = np.asarray(vector, float)
    half = np.linalg.norm(vector) / 2
    # sinc keeps the limit at angle zero exact.
    return quaternion_to_matrix(np.append(vector / 2 * np.sinc(half / np.pi), np.cos(half)))


def transform_points(
    points: Float[np.ndarray, "points 3"],
    position: Float[np.ndarray, " 3"],
    quaternion: Float[np.ndarray, " 4"],
) -> Float64[np.ndarray, "points 3"]:
    """Points [m] of a posed frame, in the world."""
    return np.asarray(points, float) @ quaternion_to_matrix(quaternion).T + position


def pixel_rays(intrinsics: Intrinsics) -> Float64[np.ndarray, "rows columns 3"]:
    """Ray through every pixel centre, optical frame, with z = 1 (so length along it is depth)."""
    u = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    v = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    rays = np.ones((intrinsics.height, intrinsics.width, 3))
    rays[..., 0], rays[..., 1] = u[None, :], v[:, None]
    return rays


def points_from_depth(
    depth: Float[np.ndarray, "rows columns"],
    camera: Camera,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
) -> Float64[np.ndarray, "points 3"]:
    """World points [m] of a depth image [m]; pixels of depth 0 and outside `mask` are left out.

    Raises:
        ValueError: the image's size is not the camera's.
    """
    depth, wanted = np.asarray(depth), (camera.intrinsics.height, camera.intrinsics.width)
    if depth.shape != wanted:
        raise ValueError(f"a depth image of this camera has shape {wanted}, got {depth.shape}")
    chosen = depth > 0 if mask is None else (depth > 0) & mask
    rows, columns = np.nonzero(chosen)
    return unproject(columns, rows, depth[chosen], camera)


def unproject(
    columns: Int[np.ndarray, " pixels"],
    rows: Int[np.ndarray, " pixels"],
    depth: Float[np.ndarray, " pixels"],
    camera: Camera,
) -> Float64[np.ndarray, "pixels 3"]:
    """World points [m] of pixels with a depth [m]."""
    k, z = camera.intrinsics, np.asarray(depth, float)
    points = np.stack([(columns - k.cx) / k.fx * z, (rows - k.cy) / k.fy * z, z], axis=1)
    return transform_points(points, np.array(camera.position), np.array(camera.quaternion))


def project(
    points: Float[np.ndarray, "points 3"], camera: Camera
) -> tuple[Float64[np.ndarray, "points 2"], Float64[np.ndarray, " points"]]:
    """Pixel (column, row) and depth [m] of world points [m]; depth <= 0 lies behind the camera."""
    local = np.asarray(points, float) - camera.position
    local = local @ quaternion_to_matrix(np.array(camera.quaternion))
    k, z = camera.intrinsics, local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = local[:, :2] / z[:, None] * [k.fx, k.fy] + [k.cx, k.cy]
    return pixels, z
