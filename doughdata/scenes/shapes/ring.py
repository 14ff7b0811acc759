"""A doughnut lying flat: a (super)torus, stretched along y."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.scenes.shapes.base import require_range
from doughschemas import SceneError

__all__ = ["Ring"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """Supertorus: exponent 2 is a round tube, 8 nearly square; `elongation` stretches y."""

    ring_radius: float = 0.0225  # [m], of the tube's centre line, along x
    tube_radius: float = 0.0085  # [m]
    elongation: float = 1.0
    exponent: float = 2.0

    def __post_init__(self) -> None:
        require_range("ring radius", self.ring_radius, 0.008, 0.070)
        require_range("tube radius", self.tube_radius, 0.003, 0.030)
        require_range("ring elongation", self.elongation, 0.5, 2.0, unit="")
        require_range("ring exponent", self.exponent, 2.0, 20.0, unit="")
        if self.tube_radius >= self.ring_radius:
            raise SceneError(
                f"a ring needs a hole: tube radius must be below the ring radius "
                f"{self.ring_radius:g} m, got {self.tube_radius:g}"
            )

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        rho = np.hypot(points[:, 0], points[:, 1] / self.elongation)
        across = np.abs(rho - self.ring_radius) / self.tube_radius
        up = np.abs(points[:, 2] / self.tube_radius - 1.0)
        return across**self.exponent + up**self.exponent <= 1.0

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]."""
        outer = self.ring_radius + self.tube_radius
        high = np.array([outer, outer * self.elongation, 2 * self.tube_radius])
        return np.stack([high * [-1, -1, 0], high])
