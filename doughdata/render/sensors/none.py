"""The ideal sensor."""

import numpy as np
from jaxtyping import Float32

from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["NoNoise"]


class NoNoise:
    """Reports the ideal depth, unchanged."""

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Depth [m], 0 = no hit."""
        del camera, rng  # an ideal sensor needs neither
        return image.depth
