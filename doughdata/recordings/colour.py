"""Choosing pixels by colour: ranges of hue (which wraps around), saturation and value."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from doughdata.registry import require_package
from doughschemas import BadInputError

__all__ = ["ColourRange", "colour_range"]

NUMBER = r"(\d+(?:\.\d+)?)"
RANGE = re.compile(rf"^{NUMBER}-{NUMBER}$")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourRange:
    """Pixels whose HSV values lie in all three ranges, both ends included."""

    hue: tuple[float, float]  # [degrees], 0..360; from the first upwards to the second, over 360
    saturation: tuple[float, float] = (0.25, 1.0)
    value: tuple[float, float] = (0.10, 1.0)

    def holds(self, rgb: UInt8[np.ndarray, "rows columns 3"]) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels are of this colour."""
        cv2: Any = require_package("cv2", extra="mcap")
        hsv = cv2.cvtColor(rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2HSV)
        hue, saturation, value = np.moveaxis(hsv, -1, 0)
        first, last = self.hue
        # A full circle stays one; else the way from `first` up to the pixel's hue is compared.
        reach = last - first if last >= first else last - first + 360
        inside = np.mod(hue - first, 360) <= reach + 1e-3
        for channel, (low, high) in ((saturation, self.saturation), (value, self.value)):
            inside &= (channel >= low - 1e-3) & (channel <= high + 1e-3)
        return np.asarray(inside)


def colour_range(text: str) -> ColourRange:
    """A range as users write it: `H-H[,S-S[,V-V]]`, hue in degrees, the others in percent.

    `340-20` is red, around 0.

    Raises:
        BadInputError: not of this form, or numbers outside 0..360 and 0..100.
    """
    parts = [RANGE.match(part.strip()) for part in text.split(",")]
    if not 1 <= len(parts) <= 3 or None in parts:
        raise BadInputError(
            f"a colour is H-H[,S-S[,V-V]], hue in degrees, the others in percent (340-20,30-100), "
            f"got {text!r}"
        )
    ranges = [(float(part[1]), float(part[2])) for part in parts if part is not None]
    if max(ranges[0]) > 360 or any(max(r) > 100 or r[0] > r[1] for r in ranges[1:]):
        raise BadInputError(
            f"hue lies in 0..360, saturation and value rise within 0..100, got {text!r}"
        )
    shares = {
        name: (low / 100, high / 100)
        for name, (low, high) in zip(("saturation", "value"), ranges[1:], strict=False)
    }
    return ColourRange(hue=ranges[0], **shares)
