"""The third mesher: naive surface nets over the same solid. Smooth, cheap, without slivers."""

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from doughdata.mesh.assemble import component_meshes
from doughdata.mesh.component import SolidConfig
from doughdata.mesh.contour import contour
from doughdata.mesh.solid import build_solid
from doughschemas import ComponentMeshes, FrameTopology

__all__ = ["SurfaceNets", "SurfaceNetsConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceNetsConfig:
    """Settings of the mesher."""

    solid: SolidConfig = field(default_factory=SolidConfig)
    label_spacing: float = 0.001  # [m], of the label grid
    simplify: float | None = None  # [m], how far fewer faces may move the surface; None = keep all


class SurfaceNets:
    """Dual contouring's guarantees with each vertex at the mean of its cell's crossings.

    Gibson (1998), without her relaxation. Cuts come out rounded, about as by marching cubes, with
    more even triangles: a vertex a cell instead of one a crossed edge.
    """

    def __init__(self, config: SurfaceNetsConfig | None = None) -> None:
        self.config = config or SurfaceNetsConfig()

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
        return component_meshes(
            contour(solid, regularisation=math.inf),
            solid,
            components=topology.num_components,
            label_spacing=self.config.label_spacing,
            max_error=self.config.simplify,
        )
