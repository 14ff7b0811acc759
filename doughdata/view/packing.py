"""Many arrays as one short text: differences, byte planes, deflate, base64.

For every array in turn: (1) with `delta`, each row becomes its difference from the row before,
modulo the type's range; (2) the array is transposed, so that a column is contiguous; (3) bytes of
equal significance come together, lowest first. All arrays' bytes, one after the other, are deflated
(zlib) and written in base64. `assets/data.js` undoes it.
"""

import zlib
from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Num, UInt

__all__ = ["pack", "quantise", "smallest_unsigned"]

LEVEL = 6  # of zlib: 9 takes twice as long for 1 % less
TYPES = ("uint8", "uint16", "uint32", "float32")


def pack(
    arrays: Mapping[str, Num[np.ndarray, "rows columns"]], *, plain: tuple[str, ...] = ()
) -> tuple[list[dict[str, Any]], str]:
    """Description (name, dtype, rows, columns, delta) of every array, and the text of all.

    Floats, and the arrays named in `plain`, are not differenced.

    Raises:
        ValueError: an array is not two-dimensional, or of a type that a browser has no array for.
    """
    entries, parts = [], []
    for name, array in arrays.items():
        if array.ndim != 2 or array.dtype.name not in TYPES:
            raise ValueError(
                f"{name}: a two-dimensional array of {', '.join(TYPES)} is packed, "
                f"got {array.dtype.name} of shape {array.shape}"
            )
        delta = array.dtype.kind == "u" and name not in plain
        values = array.view(np.uint32) if array.dtype.kind == "f" else array
        if delta:
            values = np.diff(values, axis=0, prepend=np.zeros_like(values[:1]))
        columns = np.ascontiguousarray(values.T).astype(values.dtype.newbyteorder("<"), copy=False)
        parts.append(columns.view(np.uint8).reshape(-1, array.itemsize).T.tobytes())
        entries.append(
            {
                "name": name,
                "dtype": array.dtype.name,
                "rows": array.shape[0],
                "columns": array.shape[1],
                "delta": delta,
            }
        )
    return entries, b64encode(zlib.compress(b"".join(parts), LEVEL)).decode()


def quantise(
    points: Num[np.ndarray, "*batch 3"], low: Num[np.ndarray, " 3"], step: float
) -> UInt[np.ndarray, "*batch 3"]:
    """Points [m] as whole steps [m] above `low`, 16 bits: off by at most half a step.

    Raises:
        ValueError: a point lies outside the 65535 steps.
    """
    steps = np.rint((np.asarray(points, float) - low) / step)
    if steps.size and not (steps.min() >= 0 and steps.max() <= 65535):
        raise ValueError(
            f"points must lie within 65535 steps, got {steps.min():.0f} to {steps.max():.0f}"
        )
    return steps.astype(np.uint16)


def smallest_unsigned(values: Num[np.ndarray, "*shape"]) -> UInt[np.ndarray, "*shape"]:
    """The same whole numbers >= 0 in the smallest unsigned type that holds them."""
    most = int(values.max()) if values.size else 0
    return values.astype(np.uint8 if most < 256 else np.uint16 if most < 65536 else np.uint32)
