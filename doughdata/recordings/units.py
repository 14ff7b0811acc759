"""Depth as the dataset stores it: whole units, as fine as the values allow."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt16

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.frames import RawFrame

__all__ = ["COARSE", "FINE", "DepthUnits", "DepthUnitsError", "choose_units"]

FINE, COARSE = 1e-4, 1e-3  # [m]
MILLIMETRE = 1e-3
MOST = 65535


class DepthUnitsError(Exception):
    """A frame holds values that the chosen unit cannot; a coarser one is needed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthUnits:
    """How values of the recording become values of the dataset."""

    unit: float  # [m], of the dataset
    factor: int | None  # dataset units a recorded unit; None: the recording has floats
    scale: float = 1.0  # [m], a recorded unit of floats
    guessed: bool = False  # whether nobody said what a recorded unit is

    def stored(self, frame: RawFrame) -> UInt16[np.ndarray, "rows columns"]:
        """Depth in dataset units, 0 = invalid. Values of 16-bit depth come through exactly.

        Raises:
            DepthUnitsError: a value does not fit.
        """
        if self.factor is not None:
            values = frame.depth.astype(np.uint32) * np.uint32(self.factor)
        else:
            clean = np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0)
            values = np.rint(np.maximum(clean, 0).astype(np.float64) * (self.scale / self.unit))
        if values.max() > MOST:
            if self.unit < COARSE and self.unit == FINE:
                raise DepthUnitsError
            values = np.where(values > MOST, 0, values)
        return values.astype(np.uint16)

    def beyond(self, frame: RawFrame) -> int:
        """Pixels with a depth that does not fit any more: they are stored as invalid."""
        most = MOST * self.unit / (self.scale if self.factor is None else self.unit / self.factor)
        return int(np.count_nonzero(np.isfinite(frame.depth) & (frame.depth > most)))

    def metres(
        self, stored: UInt16[np.ndarray, "rows columns"]
    ) -> Float64[np.ndarray, "rows columns"]:
        """Depth [m] of stored values."""
        return stored * self.unit


def choose_units(frame: RawFrame, scale: float | None, *, fine: bool = True) -> DepthUnits:
    """Units for a recording, by its first frame.

    Args:
        frame: any frame.
        scale: metres per recorded unit as the user said, or None.
        fine: 0.1 mm if the values are whole multiples of it; False after a value did not fit.

    Raises:
        RecordingError: mono16 is no depth unless the user gives its scale.
    """
    if frame.depth.dtype.kind == "f":
        return DepthUnits(unit=FINE if fine else COARSE, factor=None, scale=scale or 1.0)
    if frame.encoding == "mono16" and scale is None:
        raise RecordingError(
            "mono16 says nothing about depth: --depth-scale 0.001 reads it as millimetres"
        )
    guessed = scale is None and not frame.unit_known
    scale = MILLIMETRE if scale is None else scale
    steps = round(scale / FINE)
    if fine and steps >= 1 and abs(scale - steps * FINE) < 1e-9:
        return DepthUnits(unit=FINE, factor=steps, guessed=guessed)
    return DepthUnits(unit=scale, factor=1, guessed=guessed)
