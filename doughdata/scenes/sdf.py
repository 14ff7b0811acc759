"""Signed distance of a finger, sampled on a grid: what simulator and checks collide with."""

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from doughdata.registry import require_package
from doughdata.scenes.tools import finger_mesh
from doughschemas import SceneError, Tool

__all__ = ["SignedDistanceGrid", "finger_sdf"]

FINEST = 0.0005  # [m]; a 3 mm blade spans six cells
MARGIN = 0.010  # [m], grid beyond the finger on every side: three cells of a 3.1 mm MPM grid
MOST_NODES = 4_000_000  # 16 MB; larger tools get a coarser grid
CACHED = 32  # fingers kept in memory
LARGEST = 0.5  # [m]; the workspace is 0.2 m wide, so a longer finger is a file in millimetres


@dataclass(frozen=True, slots=True, kw_only=True)
class SignedDistanceGrid:
    """Distance to a surface at the nodes `origin + index * spacing`; negative inside."""

    values: Float32[np.ndarray, "nx ny nz"]  # [m]
    origin: Float64[np.ndarray, " 3"]  # [m], finger frame
    spacing: float  # [m]

    def sample(self, points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, " points"]:
        """Trilinear distance [m] at points [m] in the finger frame.

        Outside the grid: the value at the nearest point of the grid box plus the distance to that
        point, which is an upper bound of the true distance and continuous.
        """
        last = np.array(self.values.shape) - 1
        index = (np.asarray(points, dtype=np.float64) - self.origin) / self.spacing
        inside = np.clip(index, 0, last)
        beyond = np.linalg.norm(index - inside, axis=1) * self.spacing
        low = np.minimum(inside.astype(int), last - 1)
        fraction = inside - low
        _, ny, nz = self.values.shape
        flat = self.values.reshape(-1)
        first = (low[:, 0] * ny + low[:, 1]) * nz + low[:, 2]
        total = np.zeros(len(index))
        share = ((1.0 - fraction).T, fraction.T)  # of the lower and the upper node, by axis
        for i, j, k in np.ndindex(2, 2, 2):
            weight = share[i][0] * share[j][1] * share[k][2]
            total += weight * flat[first + ((i * ny + j) * nz + k)]
        return total + beyond


def finger_sdf(tool: Tool) -> SignedDistanceGrid:
    """Signed distance of one finger in its own frame (face at x = 0, lowest point z = 0).

    A box is exact at the nodes. A mesh is measured by Open3D's ray-casting scene, which counts
    crossings: normals may point either way. Nodes are at most 0.5 mm apart unless the finger is so
    large that the grid would pass 4 million nodes; the grid reaches 10 mm beyond the finger. Kept
    in memory per process, keyed by the content.

    Raises:
        SceneError: the mesh file is missing, no mesh, not watertight, or longer than 0.5 m.
        MissingPackageError: a mesh finger without the `render` extra.
    """
    if tool.mesh is None:
        return _box_grid(tool.depth, tool.width, tool.height)
    path = Path(tool.mesh)
    # A missing file is refused, in words, where the mesh is read.
    content = sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
    return _mesh_grid(tool.mesh, tool.scale, content)


@lru_cache(maxsize=CACHED)
def _box_grid(depth: float, width: float, height: float) -> SignedDistanceGrid:
    low = np.array([0.0, -width / 2, 0.0])
    high = np.array([depth, width / 2, height])
    origin, spacing, points = _nodes(low, high)
    outside = np.abs(points - (low + high) / 2) - (high - low) / 2
    # Distance to a box: Euclidean outside, to the nearest face inside.
    distance = np.linalg.norm(np.maximum(outside, 0.0), axis=-1) + np.minimum(outside.max(-1), 0.0)
    return SignedDistanceGrid(values=distance.astype(np.float32), origin=origin, spacing=spacing)


@lru_cache(maxsize=CACHED)
def _mesh_grid(path: str, scale: float, content: str) -> SignedDistanceGrid:  # noqa: ARG001 - the key
    open3d = require_package("open3d", extra="render")
    mesh = finger_mesh(Tool(name=Path(path).stem, mesh=path, scale=scale))
    _check_size(path, scale, float(mesh.extents.max()))
    origin, spacing, points = _nodes(*np.asarray(mesh.bounds))
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    distance = scene.compute_signed_distance(points.astype(np.float32), nthreads=1, nsamples=3)
    return SignedDistanceGrid(
        values=distance.numpy().astype(np.float32), origin=origin, spacing=spacing
    )


def _check_size(path: str, scale: float, longest: float) -> None:
    if longest > LARGEST:
        raise SceneError(
            f"tool mesh {path!r} must be at most {LARGEST} m long, is {longest:.4g} m at scale "
            f"{scale:g}; a file in millimetres needs scale 0.001"
        )


def _nodes(
    low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"]
) -> tuple[Float64[np.ndarray, " 3"], float, Float64[np.ndarray, "nx ny nz 3"]]:
    """Origin, spacing and nodes of a grid around a box, a node on its lowest corner."""
    size = high - low + 2 * MARGIN
    spacing = max(FINEST, float((size.prod() / MOST_NODES) ** (1 / 3)))
    before = int(np.ceil(MARGIN / spacing))
    counts = before + np.ceil((high - low + MARGIN) / spacing).astype(int) + 1
    origin = low - before * spacing
    axes = [o + spacing * np.arange(n) for o, n in zip(origin, counts, strict=True)]
    return origin, spacing, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
