"""What the mesh of a component must satisfy, and its measures."""

import numpy as np
from jaxtyping import Float, Integer

from doughdata.registry import require_package

__all__ = [
    "is_edge_manifold",
    "is_vertex_manifold",
    "mesh_area",
    "mesh_genus",
    "mesh_volume",
    "shell_count",
]


def _half_edges(faces: Integer[np.ndarray, "faces 3"]) -> Integer[np.ndarray, "half_edges 2"]:
    """Start and end of every half-edge; half-edge i * faces + f leaves corner i of face f."""
    faces = np.asarray(faces, np.int64)
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def is_edge_manifold(faces: Integer[np.ndarray, "faces 3"]) -> bool:
    """Whether every edge has two faces that run along it in opposite directions.

    Such a mesh is closed (watertight) and consistently oriented.
    """
    edges = _half_edges(faces)
    size = int(edges.max(initial=0)) + 1
    forward = np.sort(edges[:, 0] * size + edges[:, 1])
    backward = np.sort(edges[:, 1] * size + edges[:, 0])
    unique = bool((forward[1:] != forward[:-1]).all())
    return unique and bool((forward == backward).all()) and bool((edges[:, 0] != edges[:, 1]).all())


def is_vertex_manifold(faces: Integer[np.ndarray, "faces 3"]) -> bool:
    """Whether the faces around every vertex form one fan; only for edge-manifold meshes."""
    count = len(faces)
    edges = _half_edges(faces)
    size = int(edges.max(initial=0)) + 1
    order = np.argsort(edges[:, 0] * size + edges[:, 1])
    twins = np.argsort(edges[:, 1] * size + edges[:, 0])
    # half-edge a -> b and its twin b -> a: corner at a of the one meets corner at a of the other
    corner = order
    opposite = (twins + count) % (3 * count)
    fans = _components(corner, opposite, 3 * count)
    return fans == len(np.unique(faces))


def shell_count(faces: Integer[np.ndarray, "faces 3"]) -> int:
    """Number of connected surfaces."""
    edges = _half_edges(faces)
    size = int(edges.max(initial=-1)) + 1
    return _components(edges[:, 0], edges[:, 1], size) - (size - len(np.unique(faces)))


def mesh_genus(faces: Integer[np.ndarray, "faces 3"]) -> int:
    """First Betti number of the solid: sum over shells of 1 - chi / 2; closed meshes only.

    For a solid without cavities this is its number of handles; a cavity adds its own genus.
    """
    edges = len(faces) * 3 // 2
    chi = len(np.unique(faces)) - edges + len(faces)
    return shell_count(faces) - chi // 2


def mesh_volume(
    vertices: Float[np.ndarray, "vertices 3"], faces: Integer[np.ndarray, "faces 3"]
) -> float:
    """Enclosed volume, in the cube of the vertices' unit; positive if oriented outward."""
    a, b, c = np.asarray(vertices, np.float64)[np.asarray(faces, np.int64).T]
    return float((np.cross(a, b) * c).sum() / 6.0)


def mesh_area(
    vertices: Float[np.ndarray, "vertices 3"], faces: Integer[np.ndarray, "faces 3"]
) -> float:
    """Surface area, in the square of the vertices' unit."""
    a, b, c = np.asarray(vertices, np.float64)[np.asarray(faces, np.int64).T]
    return float(np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1)).sum() / 2.0)


def _components(
    a: Integer[np.ndarray, " pairs"], b: Integer[np.ndarray, " pairs"], size: int
) -> int:
    """Connected components of `size` items joined in pairs."""
    sparse = require_package("scipy.sparse", extra="sim")
    csgraph = require_package("scipy.sparse.csgraph", extra="sim")
    graph = sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), (size, size))
    return int(csgraph.connected_components(graph, directed=False)[0])
