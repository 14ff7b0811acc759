"""What a sample holds, drawn from one key frame: points, queries, tool points. Plain numpy.

Lengths in [m], world frame. Every function draws from the generator that it is handed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, Integer

from doughdata.dataset import FrameTools
from doughdata.geometry import quaternion_to_matrix, unproject
from doughdata.registry import require_package
from doughschemas import (
    NO_COMPONENT,
    SEGMENT_COMPONENT,
    ComponentMesh,
    DepthViews,
    LabelGrid,
    Tool,
)

__all__ = [
    "NO_POINT",
    "complete_points",
    "dough_points",
    "grid_labels",
    "inside_tools",
    "query_points",
    "tool_points",
]

# Box [m] of the uniform queries: the square that bodies stay in, and above it what dough reaches.
WORKSPACE = np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.06]])
NEAR_SURFACE = 0.004  # [m], standard deviation of the other queries about the surface
NO_POINT = -1  # label of padding


def dough_points(
    views: DepthViews, view: int, count: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    """`count` random dough pixels of a view as points [m], and their components.

    Points are drawn again if the view has fewer; without any they are zeros labelled NO_POINT.
    """
    row = int(np.flatnonzero(views.view_index == view)[0])
    depth, segments = views.depth[row], views.segments[row]
    pixels = np.flatnonzero(segments >= SEGMENT_COMPONENT)
    pixels = pixels[depth.flat[pixels] > 0]
    if len(pixels) == 0:
        return np.zeros((count, 3)), np.full(count, NO_POINT, np.int64)
    chosen = rng.choice(pixels, min(count, len(pixels)), replace=False)
    if len(chosen) < count:
        chosen = np.concatenate([chosen, rng.choice(chosen, count - len(chosen))])
    rows, columns = np.unravel_index(chosen, depth.shape)
    points = unproject(columns, rows, depth.flat[chosen] * views.depth_unit, views.cameras[row])
    return points, segments.flat[chosen].astype(np.int64) - SEGMENT_COMPONENT


def complete_points(
    meshes: tuple[ComponentMesh, ...], count: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    """`count` points [m] all over the true surfaces, uniform by area, and their components.

    Without any surface they are zeros labelled NO_POINT.
    """
    surface = _Surface.of(meshes)
    if not surface.area > 0:
        return np.zeros((count, 3)), np.full(count, NO_POINT, np.int64)
    points, face = surface.draw(count, rng)
    ends = np.cumsum([len(mesh.faces) for mesh in meshes])
    return points, np.searchsorted(ends, face, side="right")


def query_points(
    meshes: tuple[ComponentMesh, ...], count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "queries 3"]:
    """Half uniform in the workspace, half normal about random points of the surfaces [m]."""
    near = count // 2 if meshes else 0
    uniform = rng.uniform(*WORKSPACE, size=(count - near, 3))
    if near == 0:
        return uniform
    surface, _ = _Surface.of(meshes).draw(near, rng)
    return np.concatenate([uniform, surface + rng.normal(0.0, NEAR_SURFACE, (near, 3))])


def grid_labels(
    grid: LabelGrid, points: Float64[np.ndarray, "points 3"]
) -> Int64[np.ndarray, " points"]:
    """Label of the nearest node; outside the grid there is nothing."""
    node = np.rint((points - grid.origin) / grid.spacing).astype(np.int64)
    inside = ((node >= 0) & (node < grid.labels.shape)).all(axis=1)
    labels = np.full(len(points), NO_COMPONENT, np.int64)
    labels[inside] = grid.labels[tuple(node[inside].T)]
    return labels


def tool_points(
    tools: FrameTools, count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "fingers points 3"]:
    """Points on the surface of every finger [m], world."""
    drawn, _ = _finger(tools.tool).draw(len(tools.position) * count, rng)
    rotation = quaternion_to_matrix(tools.quaternion)
    local = drawn.reshape(-1, count, 3)
    return local @ np.swapaxes(rotation, 1, 2) + tools.position[:, None]


def inside_tools(
    tools: FrameTools, points: Float64[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Which points [m] lie inside a finger or on its surface."""
    finger = _finger(tools.tool)
    low, high = finger.vertices.min(axis=0), finger.vertices.max(axis=0)
    inside = np.zeros(len(points), bool)
    for position, quaternion in zip(tools.position, tools.quaternion, strict=True):
        local = (points - position) @ quaternion_to_matrix(quaternion)
        near = np.flatnonzero(((local >= low) & (local <= high)).all(axis=1))
        if tools.tool.mesh is not None and len(near):
            near = near[_inside_mesh(finger, local[near])]
        inside[near] = True
    return inside


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Triangles from which points are drawn, uniform by area."""

    vertices: Float[np.ndarray, "vertices 3"]  # [m]
    faces: Integer[np.ndarray, "faces 3"]
    ends: Float64[np.ndarray, " faces"]  # sum of the doubled areas up to each face

    @classmethod
    def of(cls, meshes: Sequence[ComponentMesh]) -> "_Surface":
        """All meshes as one."""
        if not meshes:
            return cls.made_of(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
        if len(meshes) == 1:
            return cls.made_of(meshes[0].vertices, meshes[0].faces)
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])]).tolist()
        faces = [mesh.faces + np.int64(k) for mesh, k in zip(meshes, first, strict=True)]
        return cls.made_of(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))

    @classmethod
    def made_of(
        cls, vertices: Float[np.ndarray, "vertices 3"], faces: Integer[np.ndarray, "faces 3"]
    ) -> "_Surface":
        """Areas by coordinate: a tenth of the time of gathering corners and `np.cross`."""
        x, y, z = np.ascontiguousarray(vertices.T)
        a, b, c = np.ascontiguousarray(faces.T, dtype=np.intp)
        first = [v.take(a) for v in (x, y, z)]
        ux, uy, uz = (v.take(b) - v0 for v, v0 in zip((x, y, z), first, strict=True))
        wx, wy, wz = (v.take(c) - v0 for v, v0 in zip((x, y, z), first, strict=True))
        square = (uy * wz - uz * wy) ** 2 + (uz * wx - ux * wz) ** 2 + (ux * wy - uy * wx) ** 2
        return cls(vertices, faces, np.cumsum(np.sqrt(square), dtype=np.float64))

    @property
    def area(self) -> float:
        """Twice the area [m2]."""
        return float(self.ends[-1]) if len(self.ends) else 0.0

    def draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
        """Points [m] and their faces: square-root barycentric sampling (Osada et al. 2002)."""
        face = np.searchsorted(self.ends, rng.random(count) * self.area, side="right")
        face = np.minimum(face, len(self.faces) - 1)
        a, b, c = np.moveaxis(self.vertices[self.faces[face]].astype(np.float64), 1, 0)
        root, share = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        return (1 - root) * a + root * (1 - share) * b + root * share * c, face


@lru_cache(maxsize=32)
def _finger(tool: Tool) -> _Surface:
    """Surface of one finger [m], finger frame; a box needs no mesh library."""
    if tool.mesh is not None:
        trimesh = require_package("trimesh", extra="sim")
        mesh = trimesh.load(tool.mesh, force="mesh")
        return _Surface.made_of(
            np.asarray(mesh.vertices, np.float64) * tool.scale, np.asarray(mesh.faces, np.int64)
        )
    corner = np.array(list(np.ndindex(2, 2, 2)), float)
    corner = (corner - [0.0, 0.5, 0.0]) * [tool.depth, tool.width, tool.height]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([three for a, b, c, d in quads for three in ((a, b, c), (a, c, d))])
    return _Surface.made_of(corner, faces)


def _inside_mesh(
    finger: _Surface, points: Float64[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Which points lie inside a closed surface."""
    geometry = require_package("open3d", extra="render").t.geometry
    scene = geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(finger.vertices.astype(np.float32), finger.faces.astype(np.uint32))
    # Three rays a point: one may slip through an edge.
    return scene.compute_occupancy(points.astype(np.float32), nsamples=3).numpy() > 0.5
