"""A body in the form of any closed mesh."""

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.geometry import quaternion_to_matrix
from doughdata.registry import require_package
from doughdata.scenes.shapes.base import require_range
from doughschemas import SceneError

if TYPE_CHECKING:
    import trimesh

__all__ = ["SolidMesh", "body_mesh", "mesh_digest"]

CACHED = 16  # meshes kept in memory


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidMesh:
    """A watertight mesh (STL, OBJ, GLB, PLY), scaled and turned, its lowest point on the table.

    The shape's origin is the middle of the turned bounding box, on the table. Which points are
    inside is decided by Open3D's ray casting, three rays a point.
    """

    file: str = ""  # a path; in a dataset `assets/bodies/<sha256>.glb`
    scale: float = 1.0  # [m per mesh unit]
    qx: float = 0.0  # rotation from the mesh's frame (xyzw), normalised
    qy: float = 0.0
    qz: float = 0.0
    qw: float = 1.0

    def __post_init__(self) -> None:
        require_range("mesh scale", self.scale, 1e-9, 1e3, unit="m per mesh unit")
        for axis in ("qx", "qy", "qz", "qw"):
            require_range(f"mesh {axis}", getattr(self, axis), -1.0, 1.0, unit="")
        if np.linalg.norm(self._quaternion()) < 0.5:
            raise SceneError("mesh qx, qy, qz, qw must be a unit quaternion, got one near zero")
        if self.file:
            low, high = self.bounds()
            require_range("mesh longest side", float((high - low).max()), 0.006, 0.180)

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        if len(points) == 0:
            return np.zeros(0, bool)
        matrix, middle = self._placement()
        local = ((points + middle) @ matrix / self.scale).astype(np.float32)
        scene = _ray_scene(self.file, _content(self.file))
        return scene.compute_occupancy(local, nthreads=1, nsamples=3).numpy() > 0

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]."""
        matrix, middle = self._placement()
        turned = body_mesh(self.file).vertices @ matrix.T * self.scale - middle
        return np.stack([turned.min(axis=0), turned.max(axis=0)])

    def _quaternion(self) -> Float64[np.ndarray, " 4"]:
        return np.array([self.qx, self.qy, self.qz, self.qw], dtype=np.float64)

    def _placement(self) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]]:
        """Rotation of the mesh, and what is taken off its points [m] to stand at the origin."""
        matrix = quaternion_to_matrix(self._quaternion())
        turned = body_mesh(self.file).vertices @ matrix.T * self.scale
        low, high = turned.min(axis=0), turned.max(axis=0)
        return matrix, np.array([*(low + high)[:2] / 2, low[2]])


def body_mesh(file: str | Path) -> "trimesh.Trimesh":
    """The mesh of a body in its own frame and units.

    Raises:
        SceneError: the file is missing, no mesh, not watertight, or in several pieces.
        MissingPackageError: trimesh is not installed.
    """
    return _body_mesh(str(file), _content(str(file)))


def mesh_digest(file: str | Path) -> str:
    """Hex sha256 of a body mesh's triangles in single precision, sorted.

    The same surface has the same digest under any path, in any order of its triangles, and after
    it was written to a format in single precision (STL, GLB).
    """
    mesh = body_mesh(file)
    corners = np.asarray(mesh.vertices, dtype=np.float32)[mesh.faces]
    first = np.array([np.lexsort(triangle.T[::-1])[0] for triangle in corners])
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)[None])[..., None] % 3, 1)
    rows = turned.reshape(len(turned), 9)
    return sha256(rows[np.lexsort(rows.T[::-1])].astype("<f4").tobytes()).hexdigest()


def _content(file: str) -> str:
    """Hash of the file, the key of what is kept in memory."""
    path = Path(file)
    if not file:
        raise SceneError("shape 'mesh' needs the parameter file, the path of a watertight mesh")
    if not path.is_file():
        raise SceneError(f"body mesh: file {file!r} not found")
    return sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=CACHED)
def _body_mesh(file: str, content: str) -> "trimesh.Trimesh":  # noqa: ARG001 - the key
    trimesh = require_package("trimesh", extra="sim")
    try:
        mesh = trimesh.load(file, force="mesh")
    except Exception as error:  # every loader has its own exceptions
        reason = " ".join(str(error).split())
        raise SceneError(f"body mesh: cannot read {file!r}: {reason}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"body mesh: {file!r} holds no triangles")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if not np.isfinite(mesh.vertices).all():
        raise SceneError(f"body mesh: {file!r} has vertices that are no numbers")
    if not mesh.is_watertight:
        raise SceneError(
            f"body mesh: {file!r} must be watertight; close its holes (every edge needs two faces)"
        )
    if mesh.body_count != 1:
        raise SceneError(
            f"body mesh: {file!r} must be one closed surface, got {mesh.body_count}; "
            "make each piece a body of its own"
        )
    return mesh


@lru_cache(maxsize=CACHED)
def _ray_scene(file: str, content: str):
    open3d = require_package("open3d", extra="render")
    mesh = _body_mesh(file, content)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return scene
