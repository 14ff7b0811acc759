"""The mesh checks against trimesh and against meshes made wrong on purpose."""

import numpy as np
import pytest
import trimesh

from doughdata.mesh.checks import (
    is_edge_manifold,
    is_vertex_manifold,
    mesh_area,
    mesh_genus,
    mesh_volume,
    shell_count,
)

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.mark.parametrize(
    ("mesh", "genus"),
    [
        (trimesh.creation.icosphere(2), 0),
        (trimesh.creation.torus(2.0, 0.5), 1),
        (trimesh.creation.annulus(1.0, 2.0, 1.0), 1),
    ],
)
def test_measures_agree_with_trimesh(mesh: trimesh.Trimesh, genus: int) -> None:
    """Closedness, shells, genus, volume and area are those that trimesh or geometry gives."""
    assert is_edge_manifold(mesh.faces)
    assert is_vertex_manifold(mesh.faces)
    assert shell_count(mesh.faces) == mesh.body_count
    assert mesh_genus(mesh.faces) == genus
    assert mesh_volume(mesh.vertices, mesh.faces) == pytest.approx(mesh.volume)
    assert mesh_area(mesh.vertices, mesh.faces) == pytest.approx(mesh.area)


def test_genus_adds_over_shells() -> None:
    """A torus beside a sphere has two shells and genus one."""
    both = trimesh.util.concatenate([trimesh.creation.torus(2.0, 0.5), trimesh.creation.box()])
    assert shell_count(both.faces) == 2
    assert mesh_genus(both.faces) == 1


def test_open_mesh_is_not_manifold() -> None:
    """A tetrahedron without a face, or with a face turned, is refused."""
    turned = TETRAHEDRON.copy()
    turned[0] = turned[0, ::-1]
    assert is_edge_manifold(TETRAHEDRON)
    assert not is_edge_manifold(TETRAHEDRON[1:])
    assert not is_edge_manifold(turned)


def test_shared_edge_is_not_manifold() -> None:
    """Two tetrahedra that share an edge alone put four faces on it."""
    other = np.array([0, 1, 4, 5])[TETRAHEDRON]
    assert not is_edge_manifold(np.concatenate([TETRAHEDRON, other]))


def test_shared_vertex_is_not_vertex_manifold() -> None:
    """Two tetrahedra that share a vertex alone are edge-manifold but not vertex-manifold."""
    other = np.array([0, 4, 5, 6])[TETRAHEDRON]
    both = np.concatenate([TETRAHEDRON, other])
    assert is_edge_manifold(both)
    assert not is_vertex_manifold(both)
    assert is_vertex_manifold(TETRAHEDRON)
