"""A pretzel lying flat: a chain of rings along y, so that its genus is the number of holes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from doughdata.scenes.shapes.base import require_range
from doughschemas import SceneError

__all__ = ["Pretzel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pretzel:
    """Round tubes whose circular centre lines touch: two neighbouring holes share one tube."""

    holes: int = 3
    ring_radius: float = 0.016  # [m], of each centre line
    tube_radius: float = 0.006  # [m]

    def __post_init__(self) -> None:
        require_range("pretzel holes", self.holes, 2.0, 6.0, unit="")
        require_range("pretzel ring radius", self.ring_radius, 0.008, 0.040)
        require_range("pretzel tube radius", self.tube_radius, 0.003, 0.020)
        if self.tube_radius >= self.ring_radius:
            raise SceneError(
                f"a pretzel needs holes: tube radius must be below the ring radius "
                f"{self.ring_radius:g} m, got {self.tube_radius:g}"
            )

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        up = (points[:, 2] - self.tube_radius) ** 2
        inside = np.zeros(len(points), bool)
        for y in self.centres():
            rho = np.hypot(points[:, 0], points[:, 1] - y)
            inside |= (rho - self.ring_radius) ** 2 + up <= self.tube_radius**2
        return inside

    def centres(self) -> Float64[np.ndarray, " holes"]:
        """Middle of each hole along y [m]."""
        return (np.arange(self.holes) - (self.holes - 1) / 2) * 2 * self.ring_radius

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]."""
        outer = self.ring_radius + self.tube_radius
        high = np.array([outer, outer + self.centres()[-1], 2 * self.tube_radius])
        return np.stack([high * [-1, -1, 0], high])
