"""Counting on graphs and triangle meshes, in numpy alone: a reading installation has no trimesh."""

import numpy as np
from jaxtyping import Float, Integer

__all__ = ["component_count", "mesh_genus", "mesh_volume", "mesh_watertight"]


def component_count(edges: Integer[np.ndarray, "edges 2"], nodes: int) -> int:
    """Connected components of a graph: every node takes the least label it can reach."""
    label = np.arange(nodes)
    a, b = edges[:, 0].astype(np.int64), edges[:, 1].astype(np.int64)
    while True:
        before = label.copy()
        least = np.minimum(label[a], label[b])
        np.minimum.at(label, before[a], least)  # the roots take part, so paths halve each round
        np.minimum.at(label, before[b], least)
        np.minimum.at(label, a, least)
        np.minimum.at(label, b, least)
        label = label[label]
        if np.array_equal(label, before):
            return len(np.unique(label))


def mesh_watertight(faces: Integer[np.ndarray, "faces 3"], vertices: int) -> bool:
    """Whether every edge is used once in each direction: closed, manifold, one orientation."""
    if len(faces) == 0 or faces.max() >= vertices:
        return False
    start = faces.astype(np.int64).ravel()
    stop = np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    forward, backward = start * vertices + stop, stop * vertices + start
    there = np.unique(forward)
    unique = len(there) == len(forward) and bool(np.all(start != stop))
    return unique and np.array_equal(there, np.unique(backward))


def mesh_genus(faces: Integer[np.ndarray, "faces 3"]) -> int:
    """Genus of a watertight mesh, summed over its shells: shells - (V - E + F) / 2."""
    used, corner = np.unique(faces, return_inverse=True)
    corner = corner.reshape(-1, 3)
    edges = np.concatenate([corner[:, :2], corner[:, 1:]])
    shells = component_count(edges, len(used))
    euler = len(used) - 3 * len(faces) // 2 + len(faces)
    return shells - euler // 2


def mesh_volume(
    vertices: Float[np.ndarray, "vertices 3"], faces: Integer[np.ndarray, "faces 3"]
) -> float:
    """Signed volume [m3] by the divergence theorem; positive if the faces point outwards."""
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
