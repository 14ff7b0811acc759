"""Azure Kinect (time of flight), by the chain of BlenderProc's `add_kinect_azure_noise`."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from doughdata.render.incidence import incidence_angle
from doughdata.render.sensors.blenderproc import BlenderProc, BlenderProcConfig
from doughdata.stages import DepthImage
from doughschemas import Camera

__all__ = ["Azure", "AzureConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AzureConfig:
    """Constants of the chain: BlenderProc 2.8, after Tolgyessy et al. (Sensors, 2021).

    sigma(z) = sigma + sigma_slope max(z - sigma_from, 0). Two things differ from BlenderProc. It
    drops pixels beside steps of 0.8 m, which no table top has; here the step is 20 mm. And it
    drops pixels darker than 15 of 255 in its colour picture; there is no colour here, so dark
    means what is dark to a camera that brings its own light: reflectance x cos(incidence). The
    reflectance is a choice, not a measurement.
    """

    shift_sigma: float = 0.25  # [px]
    sigma: float = 0.5e-3  # [m], standard deviation up to `sigma_from`
    sigma_from: float = 0.5  # [m]
    sigma_slope: float = 1e-3  # [m/m]
    discontinuity: float = 0.020  # [m], largest depth range of a valid 3 x 3 window
    darkness: float = 15 / 255  # share of full brightness below which a pixel is invalid
    reflectance: float = 0.5  # of dough, tools and table; 0.5 drops what is steeper than 83 degrees


class Azure:
    """The `blenderproc` chain at full resolution, less what returns too little light."""

    def __init__(self, config: AzureConfig | None = None) -> None:
        c = self.config = config or AzureConfig()
        self._chain = BlenderProc(
            BlenderProcConfig(
                low_resolution=1,
                shift_sigma=c.shift_sigma,
                discontinuity=c.discontinuity,
                sigma=c.sigma,
                sigma_from=c.sigma_from,
                sigma_slope=c.sigma_slope,
            )
        )

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid."""
        c = self.config
        noisy = self._chain.observe(image, camera, rng=rng)
        darkest = math.acos(min(c.darkness / max(c.reflectance, 1e-9), 1.0))
        bright = incidence_angle(image.depth, camera) <= darkest
        return np.where(bright, noisy, np.float32(0))
