"""`compressedDepth` of ROS's image_transport: a header, then PNG or RVL.

The header is `<i4 format, f4 A, f4 B>`. Float depth is stored as 16-bit inverse depth q with
z = A / (q - B), q = 0 = invalid. RVL (Wilson 2017) begins with u32 columns, u32 rows.
"""

import struct

import numpy as np
from jaxtyping import Float32, UInt16

from doughdata.recordings.opencv import MOST_PIXELS, decoded_file, is_png
from doughdata.recordings.pictures import PictureError
from doughdata.recordings.rvl import decode_rvl

__all__ = ["decode_compressed_depth"]

HEADER = struct.Struct("<iff")
SIZE = struct.Struct("<II")


def decode_compressed_depth(
    data: bytes, form: str
) -> UInt16[np.ndarray, "rows columns"] | Float32[np.ndarray, "rows columns"]:
    """16-bit units, or float metres with NaN for invalid.

    Args:
        data: content of the message.
        form: its `format`, e.g. "16UC1; compressedDepth png"; without a codec it means PNG.

    Raises:
        PictureError: too short, damaged, or a codec or encoding that is not known.
    """
    form = form.lower()
    if len(data) < HEADER.size:
        raise PictureError(f"has only {len(data)} bytes")
    _, a, b = HEADER.unpack_from(data)
    body = data[HEADER.size :]
    codec = form.partition("compresseddepth")[2].strip()
    if codec == "rvl":
        pixels = _rvl(body)
    elif codec in ("", "png"):
        pixels = _png(body)
    else:
        raise PictureError(f"has depth codec {codec[:20]!r}; known are png and rvl")
    encoding = form.partition(";")[0].strip()
    if encoding == "32fc1":
        return _metres(pixels, a, b)
    if encoding in ("16uc1", "mono16") or "compresseddepth" in encoding:
        return pixels
    raise PictureError(f"has depth encoding {encoding[:20]!r}; known are 16uc1 and 32fc1")


def _metres(
    inverse: UInt16[np.ndarray, "rows columns"], a: float, b: float
) -> Float32[np.ndarray, "rows columns"]:
    if not (np.isfinite([a, b]).all() and a > 0):
        raise PictureError(f"has quantisation parameters {a:g} and {b:g}")
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / (inverse.astype(np.float32) - np.float32(b))
    depth[(inverse == 0) | ~np.isfinite(depth)] = np.nan
    return depth.astype(np.float32)


def _png(data: bytes) -> UInt16[np.ndarray, "rows columns"]:
    pixels = decoded_file(data, color=False) if is_png(data) else None
    if pixels is None:
        raise PictureError("is cut or damaged inside")
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise PictureError(f"holds {pixels.dtype} pixels of shape {pixels.shape}, not 16-bit depth")
    return pixels


def _rvl(data: bytes) -> UInt16[np.ndarray, "rows columns"]:
    if len(data) < SIZE.size:
        raise PictureError("is cut")
    columns, rows = SIZE.unpack_from(data)
    if not 0 < columns * rows <= MOST_PIXELS:
        raise PictureError(f"has {columns} x {rows} pixels")
    return decode_rvl(data[SIZE.size :], columns * rows).reshape(rows, columns)
