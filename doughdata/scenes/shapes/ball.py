"""A ball of dough, round to flattened."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.scenes.shapes.base import require_range

__all__ = ["Ball"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ball:
    """Ellipsoid of revolution about z: `flatness` is its height over its width."""

    radius: float = 0.015  # [m], horizontal
    flatness: float = 1.0

    def __post_init__(self) -> None:
        require_range("ball radius", self.radius, 0.004, 0.040)
        require_range("ball flatness", self.flatness, 0.3, 1.5, unit="")

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        x, y = points[:, 0] / self.radius, points[:, 1] / self.radius
        z = points[:, 2] / (self.radius * self.flatness) - 1.0
        return x**2 + y**2 + z**2 <= 1.0

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]."""
        r = self.radius
        return np.array([[-r, -r, 0.0], [r, r, 2 * r * self.flatness]])
