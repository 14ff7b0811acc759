"""From a contour in cells to the record of a key frame, for every mesher that contours."""

import numpy as np

from doughdata.mesh.contour import Contour
from doughdata.mesh.labels import label_grid
from doughdata.mesh.simplify import simplify
from doughdata.mesh.solid import Solid
from doughschemas import ComponentMesh, ComponentMeshes

__all__ = ["component_meshes"]


def component_meshes(
    surface: Contour,
    solid: Solid,
    *,
    components: int,
    label_spacing: float,
    max_error: float | None,
) -> ComponentMeshes:
    """Split a contour into its components' meshes [m] and sample the label grid.

    Args:
        surface: [cells], on the lattice of the solid.
        solid: what was contoured.
        components: number of labels; one without a surface gets an empty mesh.
        label_spacing: of the label grid [m].
        max_error: how far simplification may move the surface [m]; None = no simplification.
    """
    vertices = ((surface.vertices + solid.origin) * solid.cell).astype(np.float32)
    meshes = []
    for label in range(components):
        v0, v1 = np.searchsorted(surface.vertex_labels, [label, label + 1])
        f0, f1 = np.searchsorted(surface.face_labels, [label, label + 1])
        faces = (surface.faces[f0:f1] - v0).astype(np.uint32)
        meshes.append(ComponentMesh(vertices=vertices[v0:v1], faces=faces))
    grid = label_grid(solid, spacing=label_spacing, shift=surface.shift)
    if max_error is not None:
        meshes = simplify(meshes, max_error=max_error)
    return ComponentMeshes(meshes=tuple(meshes), label_grid=grid)
