"""What a sample holds, drawn from one key frame: points, queries, tool points. Plain numpy.

Lengths in [m], world frame. Every function draws from the generator that it is handed.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from doughdata.dataset import FrameTools
from doughdata.geometry import points_from_depth, quaternion_to_matrix, transform_points
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
    pixels = np.flatnonzero((segments >= SEGMENT_COMPONENT) & (depth > 0))
    if len(pixels) == 0:
        return np.zeros((count, 3)), np.full(count, NO_POINT, np.int64)
    chosen = np.sort(rng.choice(pixels, min(count, len(pixels)), replace=False))
    mask = np.zeros(depth.shape, bool)
    mask.flat[chosen] = True
    points = points_from_depth(depth * views.depth_unit, views.cameras[row], mask)
    labels = segments.flat[chosen].astype(np.int64) - SEGMENT_COMPONENT
    order = rng.permutation(len(chosen))
    if len(order) < count:
        order = np.concatenate([order, rng.choice(len(chosen), count - len(order))])
    return points[order], labels[order]


def complete_points(
    meshes: tuple[ComponentMesh, ...], count: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    """`count` points [m] all over the true surfaces, uniform by area, and their components.

    Without any surface they are zeros labelled NO_POINT.
    """
    corners = [mesh.vertices[mesh.faces].astype(np.float64) for mesh in meshes]
    areas = np.array([np.linalg.norm(_doubled_normals(c), axis=1).sum() for c in corners])
    if areas.sum() == 0:
        return np.zeros((count, 3)), np.full(count, NO_POINT, np.int64)
    labels = np.sort(rng.choice(len(areas), count, p=areas / areas.sum()))
    counts = np.bincount(labels, minlength=len(areas)).tolist()
    parts = [_surface_points(c, n, rng) for c, n in zip(corners, counts, strict=True) if n]
    order = rng.permutation(count)
    return np.concatenate(parts)[order], labels[order]


def query_points(
    meshes: tuple[ComponentMesh, ...], count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "queries 3"]:
    """Half uniform in the workspace, half normal about random points of the surfaces [m]."""
    near = count // 2 if meshes else 0
    uniform = rng.uniform(*WORKSPACE, size=(count - near, 3))
    if near == 0:
        return uniform
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]).astype(np.float64)
    surface = _surface_points(corners, near, rng)
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
    triangles = _finger_triangles(tools.tool)
    return np.stack(
        [
            transform_points(_surface_points(triangles, count, rng), position, quaternion)
            for position, quaternion in zip(tools.position, tools.quaternion, strict=True)
        ]
    )


def inside_tools(
    tools: FrameTools, points: Float64[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Which points [m] lie inside a finger or on its surface."""
    triangles = _finger_triangles(tools.tool)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    inside = np.zeros(len(points), bool)
    for position, quaternion in zip(tools.position, tools.quaternion, strict=True):
        local = (points - position) @ quaternion_to_matrix(quaternion)
        near = np.flatnonzero(((local >= low) & (local <= high)).all(axis=1))
        if tools.tool.mesh is not None and len(near):
            near = near[_inside_mesh(triangles, local[near])]
        inside[near] = True
    return inside


def _surface_points(
    triangles: Float64[np.ndarray, "triangles 3 3"], count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "points 3"]:
    """Points uniform by area: square-root barycentric sampling (Osada et al. 2002)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ends = np.cumsum(np.linalg.norm(_doubled_normals(triangles), axis=1))
    face = np.searchsorted(ends, rng.random(count) * ends[-1])
    face = np.minimum(face, len(triangles) - 1)
    root, share = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    return (1 - root) * a[face] + root * (1 - share) * b[face] + root * share * c[face]


def _doubled_normals(
    triangles: Float64[np.ndarray, "triangles 3 3"],
) -> Float64[np.ndarray, "triangles 3"]:
    """Normals whose length is twice the area."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.cross(b - a, c - a)


def _finger_triangles(tool: Tool) -> Float64[np.ndarray, "triangles 3 3"]:
    """Surface of one finger [m], finger frame; a box needs no mesh library."""
    if tool.mesh is not None:
        trimesh = require_package("trimesh", extra="sim")
        mesh = trimesh.load(tool.mesh, force="mesh")
        return np.asarray(mesh.triangles, np.float64) * tool.scale
    corner = np.array(list(np.ndindex(2, 2, 2)), float)
    corner = (corner - [0.0, 0.5, 0.0]) * [tool.depth, tool.width, tool.height]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.concatenate([corner[[[a, b, c], [a, c, d]]] for a, b, c, d in quads])


def _inside_mesh(
    triangles: Float64[np.ndarray, "triangles 3 3"], points: Float64[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Which points lie inside a closed surface."""
    geometry = require_package("open3d", extra="render").t.geometry
    corners = triangles.reshape(-1, 3).astype(np.float32)
    scene = geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    # Three rays a point: one may slip through an edge.
    return scene.compute_occupancy(points.astype(np.float32), nsamples=3).numpy() > 0.5
