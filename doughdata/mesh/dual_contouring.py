"""The default mesher: closing of the particles, contoured with sharp cuts."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from doughdata.mesh.assemble import component_meshes
from doughdata.mesh.component import SolidConfig
from doughdata.mesh.contour import contour
from doughdata.mesh.solid import build_solid
from doughschemas import ComponentMeshes, FrameTopology

__all__ = ["DualContouring", "DualContouringConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DualContouringConfig:
    """Settings of the mesher."""

    solid: SolidConfig = field(default_factory=lambda: SolidConfig(sharp=True))
    regularisation: float = 0.05  # pull of a vertex to the mean of its crossings
    label_spacing: float = 0.001  # [m], of the label grid
    simplify: float | None = None  # [m], how far fewer faces may move the surface; None = keep all


class DualContouring:
    """Watertight, edge- and vertex-manifold meshes that keep cuts sharp and do not overlap."""

    def __init__(self, config: DualContouringConfig | None = None) -> None:
        self.config = config or DualContouringConfig()

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
        surface = contour(solid, regularisation=self.config.regularisation)
        return component_meshes(
            surface,
            solid,
            components=topology.num_components,
            label_spacing=self.config.label_spacing,
            max_error=self.config.simplify,
        )
