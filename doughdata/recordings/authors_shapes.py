"""Geometry of the authors' `data.h5`: its triangles become meshes, fingers and points inside."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from doughdata.dataset.graphs import mesh_volume
from doughdata.registry import require_package
from doughschemas import (
    NO_COMPONENT,
    BadInputError,
    ComponentMesh,
    LabelGrid,
    SceneGraph,
)

__all__ = ["Gripper", "fit_gripper", "label_grid", "points_inside", "schematic_graph", "welded"]

BATCH = 8  # how many points are drawn for each that is still missing
TRIALS = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Gripper:
    """Two equal boxes that face each other: finger 0 on the positive side of the closing axis."""

    middle: tuple[float, float]  # [m], of the gap
    yaw: float  # [rad] of the closing axis
    opening: float  # [m], between the contact faces
    size: tuple[float, float, float]  # [m]: depth (closing axis), width, height


def welded(corners: Float32[np.ndarray, "corners 3"]) -> ComponentMesh:
    """A mesh of triangles that were stored corner by corner; those without area are dropped.

    Corners are one vertex where they are equal to the last bit. Vertices that no triangle uses are
    gone.
    """
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    used, faces = np.unique(faces, return_inverse=True)
    return ComponentMesh(
        vertices=vertices[used].astype(np.float32), faces=faces.reshape(-1, 3).astype(np.uint32)
    )


def fit_gripper(corners: Float64[np.ndarray, "corners 3"]) -> Gripper:
    """The two boxes around the fingers' triangles [m]; the finger that comes first is finger 0.

    Raises:
        BadInputError: the triangles are not two separate fingers.
    """
    mesh = welded(corners.astype(np.float32))
    label = _pieces(mesh)
    pieces = [mesh.vertices[label == k].astype(np.float64) for k in np.unique(label)]
    if len(pieces) != 2:
        raise BadInputError(f"two separate fingers were expected, got {len(pieces)} pieces")
    first = corners[0].astype(np.float32)
    if not np.any(np.all(pieces[0].astype(np.float32) == first, axis=1)):
        pieces.reverse()
    centres = [(piece.min(axis=0) + piece.max(axis=0)) / 2 for piece in pieces]
    yaw = float(np.arctan2(*(centres[0] - centres[1])[1::-1]))
    axis, side = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    along = [piece[:, :2] @ axis for piece in pieces]
    across = np.concatenate([piece[:, :2] @ side for piece in pieces])
    gap = float(along[0].min()), float(along[1].max())
    place = axis * sum(gap) / 2 + side * (across.min() + across.max()) / 2
    return Gripper(
        middle=(float(place[0]), float(place[1])),
        yaw=yaw,
        opening=gap[0] - gap[1],
        size=(
            float(np.ptp(along[0])),
            float(np.ptp(across)),
            float(max(np.ptp(piece[:, 2]) for piece in pieces)),
        ),
    )


def points_inside(
    meshes: Sequence[ComponentMesh], count: int, rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "points 3"], UInt8[np.ndarray, " points"]]:
    """Points [m] uniform over the volume of all meshes, and the component of each.

    Every component gets at least one.

    Raises:
        BadInputError: a mesh has no inside.
    """
    volume = np.array([max(mesh_volume(mesh.vertices, mesh.faces), 0.0) for mesh in meshes])
    if not volume.all() or count < len(meshes):
        raise BadInputError("a component has no inside: its mesh is empty or turned inside out")
    numbers = np.maximum(1, np.rint(volume / volume.sum() * count)).astype(int)
    numbers[np.argmax(numbers)] += count - numbers.sum()
    points = [_inside(mesh, n, rng) for mesh, n in zip(meshes, numbers, strict=True)]
    return np.concatenate(points), np.repeat(np.arange(len(meshes)), numbers).astype(np.uint8)


def label_grid(meshes: Sequence[ComponentMesh], spacing: float) -> LabelGrid:
    """Component at every node of a grid around the meshes that is a multiple of `spacing` [m]."""
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    low = np.floor(vertices.min(axis=0) / spacing).astype(int) - 1
    high = np.ceil(vertices.max(axis=0) / spacing).astype(int) + 2
    axes = [np.arange(a, b) * spacing for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    labels = np.full(nodes.shape[:3], NO_COMPONENT, np.uint8)
    for k, mesh in enumerate(meshes):
        labels[_occupied(mesh, nodes.reshape(-1, 3)).reshape(labels.shape)] = k
    return LabelGrid(labels=labels, origin=low * spacing, spacing=spacing)


def schematic_graph(
    points: Float32[np.ndarray, "points 3"],
    labels: UInt8[np.ndarray, " points"],
    genus: Sequence[int],
) -> SceneGraph:
    """A graph with the right components and cycle ranks, and nothing else to say: a node in the
    middle of each component, and a triangle from it for each handle, over points of its own.
    """
    positions, components, edges = [], [], []
    for k, handles in enumerate(genus):
        own = points[labels == k]
        hub = len(positions)
        positions.append(own.mean(axis=0))
        for handle in range(handles):
            a = hub + 1 + 2 * handle
            positions += [own[(2 * handle + i) % len(own)] for i in (0, 1)]
            edges += [(hub, a), (a, a + 1), (hub, a + 1)]
        components += [k] * (len(positions) - hub)
    shares = np.bincount(labels, minlength=len(genus))
    nodes = np.bincount(components, minlength=len(genus))
    return SceneGraph(
        positions=np.array(positions, np.float32).reshape(-1, 3),
        components=np.array(components, np.uint8),
        particles=np.array([shares[k] // nodes[k] for k in components], np.int32),
        edges=np.array(edges, np.int32).reshape(-1, 2),
    )


def _pieces(mesh: ComponentMesh) -> np.ndarray:
    """Least vertex that each vertex is connected to by edges."""
    label = np.arange(len(mesh.vertices))
    while True:
        least = label[mesh.faces].min(axis=1)
        new = label.copy()
        np.minimum.at(new, mesh.faces, least[:, None])
        if np.array_equal(new, label):
            return label
        label = new[new]


def _inside(
    mesh: ComponentMesh, count: int, rng: np.random.Generator
) -> Float32[np.ndarray, "points 3"]:
    """Points uniform inside a mesh, by rejection from its bounding box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    found: list[np.ndarray] = []
    for _ in range(TRIALS):
        missing = count - sum(map(len, found))
        if missing <= 0:
            return np.concatenate(found)[:count].astype(np.float32)
        drawn = rng.uniform(low, high, (BATCH * missing, 3))
        found.append(drawn[_occupied(mesh, drawn)])
    raise BadInputError("a component has hardly any inside: its mesh is flat")


def _occupied(mesh: ComponentMesh, points: np.ndarray) -> np.ndarray:
    open3d: Any = require_package("open3d", extra="render")
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
    return scene.compute_occupancy(points.astype(np.float32), nthreads=1).numpy() > 0.5
