"""The second mesher: scikit-image's marching cubes over the same solid. Rounder, for comparison."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, Int

from doughdata.mesh.checks import mesh_area, mesh_volume
from doughdata.mesh.component import SolidConfig
from doughdata.mesh.labels import label_grid
from doughdata.mesh.simplify import simplify
from doughdata.mesh.solid import Solid, build_solid, shifted_field
from doughdata.registry import require_package
from doughschemas import NO_COMPONENT, ComponentMesh, ComponentMeshes, FrameTopology

__all__ = ["MarchingCubes", "MarchingCubesConfig"]

SHIFT_MAX = 0.4  # [cells], furthest that the surface moves to match a volume


@dataclass(frozen=True, slots=True, kw_only=True)
class MarchingCubesConfig:
    """Settings of the mesher."""

    solid: SolidConfig = field(default_factory=SolidConfig)
    label_spacing: float = 0.001  # [m], of the label grid
    simplify: float | None = None  # [m], how far fewer faces may move the surface; None = keep all
    volume_rounds: int = 3  # contours until the volume is right; the last one counts


class MarchingCubes:
    """Watertight meshes with a vertex on every crossed grid edge; sharp cuts come out rounded."""

    def __init__(self, config: MarchingCubesConfig | None = None) -> None:
        self.config = config or MarchingCubesConfig()

    def mesh(
        self,
        positions: Float32[np.ndarray, "particles 3"],
        topology: FrameTopology,
        *,
        spacing: float,
    ) -> ComponentMeshes:
        """Mesh one frame.

        Args:
            positions: [m], world.
            topology: labels of the particles; STRAY ones are left out.
            spacing: of the particles at rest [m].

        Raises:
            BadInputError: positions of a component are not finite, or `simplify` is not positive.
        """
        solid = build_solid(positions, topology, spacing=spacing, config=self.config.solid)
        shift = np.zeros(topology.num_components)
        pieces = _contour(solid, shift)
        for _ in range(self.config.volume_rounds - 1):
            for label, (vertices, faces) in enumerate(pieces):
                missing = solid.volumes[label] - mesh_volume(vertices, faces)
                shift[label] += missing / max(mesh_area(vertices, faces), 1e-9)
            shift = np.clip(shift, -SHIFT_MAX, SHIFT_MAX)
            pieces = _contour(solid, shift)
        meshes = [
            ComponentMesh(
                vertices=((vertices + solid.origin) * solid.cell).astype(np.float32),
                faces=faces.astype(np.uint32),
            )
            for vertices, faces in pieces
        ]
        if self.config.simplify is not None:
            meshes = simplify(meshes, max_error=self.config.simplify)
        grid = label_grid(solid, spacing=self.config.label_spacing, shift=shift)
        return ComponentMeshes(meshes=tuple(meshes), label_grid=grid)


def _contour(
    solid: Solid, shift: Float64[np.ndarray, " components"]
) -> list[tuple[Float64[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]]]:
    """Vertices [cells] and faces of every component, its surface moved out by `shift` [cells]."""
    measure = require_package("skimage.measure", extra="sim")
    if not (solid.labels != NO_COMPONENT).any():
        return [(np.zeros((0, 3)), np.zeros((0, 3), np.int64)) for _ in shift]
    values = shifted_field(solid, shift)
    # "descent": the body is where the field is low
    vertices, faces, _, _ = measure.marching_cubes(values, 0.0, gradient_direction="descent")
    low = np.floor(vertices + 1e-4).astype(np.intp)
    high = np.ceil(vertices - 1e-4).astype(np.intp)
    owner = np.minimum(solid.labels[tuple(low.T)], solid.labels[tuple(high.T)])
    pieces = []
    for label in range(len(shift)):
        mine = owner == label
        rank = np.cumsum(mine) - 1
        pieces.append((vertices[mine].astype(np.float64), rank[faces[mine[faces[:, 0]]]]))
    return pieces
