"""Raw colour encodings as ROS (`sensor_msgs/image_encodings`) and Foxglove (`RawImage`) name them.

A name ends in the bits of a channel. `8UC3` and `8UC4` are in OpenCV's order, as cv_bridge has it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8

from doughdata.registry import require_package

__all__ = ["COLOUR", "KNOWN", "Encoding"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding:
    """How the bytes of a raw image become colours."""

    channels: int  # stored a pixel
    bits: int = 8  # a channel
    order: tuple[int, int, int] = (0, 1, 2)  # which channels are red, green and blue
    opencv: str | None = None  # name of OpenCV's conversion to RGB; `order` is not used then
    even: bool = False  # whether the width must be even

    @property
    def grey(self) -> bool:
        """Whether it holds brightness alone."""
        return self.channels == 1 and self.opencv is None

    @property
    def dtype(self) -> np.dtype:
        """Of a channel."""
        return np.dtype(np.uint16 if self.bits == 16 else np.uint8)

    def rgb(self, pixels: np.ndarray) -> UInt8[np.ndarray, "rows columns 3"]:
        """Colours of (rows, columns, channels) pixels; of 16 bits the upper eight."""
        if self.opencv is not None:
            cv2: Any = require_package("cv2", extra="mcap")
            pixels = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, self.opencv))
        else:
            pixels = pixels[..., self.order]
        return np.ascontiguousarray(pixels >> 8 if self.bits == 16 else pixels).astype(np.uint8)


def _all() -> dict[str, Encoding]:
    found: dict[str, Encoding] = {}
    for bits in (8, 16):
        for name, channels, order in (
            *(("rgb", 3, (0, 1, 2)), ("bgr", 3, (2, 1, 0))),
            *(("rgba", 4, (0, 1, 2)), ("bgra", 4, (2, 1, 0)), ("mono", 1, (0, 0, 0))),
        ):
            found[f"{name}{bits}"] = Encoding(channels=channels, bits=bits, order=order)
        for tile in ("rggb", "bggr", "gbrg", "grbg"):
            name = f"COLOR_Bayer{tile.upper()}2RGB"
            found[f"bayer_{tile}{bits}"] = Encoding(channels=1, bits=bits, opencv=name)
    for name, channels, order in (("8uc1", 1, (0, 0, 0)), ("8uc3", 3, (2, 1, 0))):
        found[name] = Encoding(channels=channels, order=order)
    found["8uc4"] = Encoding(channels=4, order=(2, 1, 0))
    for name in ("yuv422", "uyvy"):
        found[name] = Encoding(channels=2, opencv="COLOR_YUV2RGB_UYVY", even=True)
    for name in ("yuv422_yuy2", "yuyv"):
        found[name] = Encoding(channels=2, opencv="COLOR_YUV2RGB_YUYV", even=True)
    return found


COLOUR = _all()  # lower case
KNOWN = "rgb, bgr, rgba, bgra, mono, Bayer (8 or 16 bits), 8UC1, 8UC3, 8UC4, uyvy, yuyv, jpeg, png"
