"""A roll of dough lying along y."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.scenes.shapes.base import require_range

__all__ = ["Roll"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Roll:
    """Prism with a superelliptic profile: exponent 2 is round, 8 nearly square."""

    radius: float = 0.010  # [m], half the width and half the height
    length: float = 0.060  # [m], along y
    exponent: float = 2.0

    def __post_init__(self) -> None:
        require_range("roll radius", self.radius, 0.003, 0.040)
        require_range("roll length", self.length, 0.006, 0.180)
        require_range("roll exponent", self.exponent, 2.0, 20.0, unit="")

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        x, z = points[:, 0] / self.radius, points[:, 2] / self.radius - 1.0
        profile = np.abs(x) ** self.exponent + np.abs(z) ** self.exponent
        return (profile <= 1.0) & (np.abs(points[:, 1]) <= self.length / 2)

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]."""
        r, half = self.radius, self.length / 2
        return np.array([[-r, -half, 0.0], [r, half, 2 * r]])
