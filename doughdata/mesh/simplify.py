"""Fewer faces, within a bound on how far the surface moves.

manifold3d collapses edges and keeps a mesh closed and manifold. Its own tolerance is no bound: the
surface moved up to 1.9 times as far. So each result is measured, and taken only if it stays within
the bound, keeps its genus and does not reach into a neighbour; otherwise a smaller tolerance is
tried, and at last the mesh stays as it is.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from doughdata.mesh.checks import is_edge_manifold, is_vertex_manifold, mesh_genus
from doughdata.registry import require_package
from doughschemas import BadInputError, ComponentMesh

__all__ = ["distance_between", "simplify"]

FIRST_TOLERANCE = 0.5  # share of the bound; the surface moves up to 1.9 times the tolerance
TRIES = 4  # tolerances, each half of the one before; then the mesh is left as it is


def simplify(meshes: Sequence[ComponentMesh], *, max_error: float) -> list[ComponentMesh]:
    """Meshes of one key frame with fewer faces, each closed, manifold and of the same genus.

    Vertices are some of the given ones, so convex parts lose a little volume. That no triangle
    cuts another is not checked: with a bound of 0.4 mm one frame of 40 had such a pair.

    Args:
        meshes: closed, manifold, without overlaps.
        max_error: greatest distance [m] of either surface from the other (`distance_between`).

    Raises:
        BadInputError: `max_error` is not positive.
        MissingPackageError: manifold3d or Open3D is not installed.
    """
    if not max_error > 0:
        raise BadInputError(f"simplify must be a positive distance [m], got {max_error!r}")
    tries = [0] * len(meshes)
    results = list(meshes)
    pending = set(range(len(meshes)))
    while pending:
        for k in pending:
            results[k], tries[k] = _within_bound(meshes[k], max_error, tries[k])
        clashing = {k for pair in _overlapping(results) for k in pair}
        # A pair that overlaps is tried again; the given meshes do not overlap, so this ends.
        pending = {k for k in clashing if tries[k] < TRIES}
        for k in pending:
            tries[k] += 1
    return results


def _within_bound(mesh: ComponentMesh, max_error: float, tries: int) -> tuple[ComponentMesh, int]:
    """The first tolerance from try number `tries` on whose result may stand, and its number."""
    if not len(mesh.faces):
        return mesh, TRIES
    for number in range(tries, TRIES):
        fewer = _collapsed(mesh, FIRST_TOLERANCE * max_error / 2**number)
        if (
            is_edge_manifold(fewer.faces)
            and is_vertex_manifold(fewer.faces)
            and mesh_genus(fewer.faces) == mesh_genus(mesh.faces)
            and distance_between(mesh, fewer) <= max_error
        ):
            return fewer, number
    return mesh, TRIES


def distance_between(fine: ComponentMesh, coarse: ComponentMesh) -> float:
    """Greatest distance [m] from one surface to the other, both ways, by Open3D.

    Taken at the vertices of the finer mesh and at the middles of edges and faces of the coarser:
    there a collapsed surface is furthest away.
    """
    corners = coarse.vertices[coarse.faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)
    probes = np.concatenate([middles, corners.mean(axis=1)]).astype(np.float32)
    there = _scene(coarse).compute_distance(fine.vertices, nthreads=1).numpy().max()
    back = _scene(fine).compute_distance(probes, nthreads=1).numpy().max()
    return float(max(there, back))


def _scene(mesh: ComponentMesh) -> Any:
    open3d = require_package("open3d", extra="render")
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh.vertices, mesh.faces)
    return scene


def _collapsed(mesh: ComponentMesh, tolerance: float) -> ComponentMesh:
    """Edges collapsed by manifold3d."""
    result = _manifold(mesh).simplify(tolerance).to_mesh64()
    return ComponentMesh(
        vertices=np.ascontiguousarray(result.vert_properties[:, :3], np.float32),
        faces=np.ascontiguousarray(result.tri_verts, np.uint32),
    )


def _overlapping(meshes: Sequence[ComponentMesh]) -> list[tuple[int, int]]:
    """Pairs that share volume."""
    boxes = [
        (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) if len(mesh.faces) else None
        for mesh in meshes
    ]
    near = [
        (a, b)
        for a, b in combinations(range(len(meshes)), 2)
        if (one := boxes[a]) is not None
        and (two := boxes[b]) is not None
        and (one[0] <= two[1]).all()
        and (two[0] <= one[1]).all()
    ]
    solids = {k: _manifold(meshes[k]) for pair in near for k in pair}
    return [(a, b) for a, b in near if (solids[a] ^ solids[b]).volume() > 0.0]


def _manifold(mesh: ComponentMesh) -> Any:
    manifold3d = require_package("manifold3d", extra="sim")
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64)
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))
