"""Pixels of an image message: colour as RGB, depth as it was stored."""

import re

import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from doughdata.recordings.compressed_depth import decode_compressed_depth
from doughdata.recordings.encodings import COLOUR, KNOWN
from doughdata.recordings.opencv import (
    MOST_PIXELS,
    decoded_file,
    is_jpeg,
    is_png,
    png_is_depth,
)
from doughdata.recordings.pictures import Picture, PictureError

__all__ = ["decode_colour", "decode_depth", "holds_depth"]

DEPTH = {"16uc1": np.uint16, "mono16": np.uint16, "32fc1": np.float32}
COMPRESSED_DEPTH = "compresseddepth"


def holds_depth(picture: Picture) -> bool:
    """Whether an image claims to be depth. mono16 may be, if the user says so."""
    if picture.compressed:  # "16UC1; png compressed" is what image_transport makes of depth
        return COMPRESSED_DEPTH in picture.format or picture.format.startswith("16uc1")
    return picture.format in ("16uc1", "32fc1")


def decode_colour(picture: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    """RGB pixels of a raw, JPEG or PNG image.

    Raises:
        PictureError: another encoding, no pixels, or data that disagree with its size.
    """
    if picture.compressed:
        return _decompressed(picture)
    if picture.format not in COLOUR:
        raise PictureError(f"has colour encoding {picture.format[:20]!r}; known are {KNOWN}")
    encoding = COLOUR[picture.format]
    if encoding.even and picture.width % 2:
        raise PictureError(f"has {picture.width} columns, {picture.format} has them in pairs")
    return encoding.rgb(_rows(picture, encoding.dtype, encoding.channels))


def decode_depth(
    picture: Picture,
) -> UInt16[np.ndarray, "rows columns"] | Float32[np.ndarray, "rows columns"]:
    """Depth pixels as stored: 16-bit units, or float metres (NaN or 0 = invalid).

    Raises:
        PictureError: another encoding, no pixels, or data that disagree with its size.
    """
    if picture.compressed:
        if COMPRESSED_DEPTH in picture.format:
            return decode_compressed_depth(picture.data, picture.format)
        return _png_depth(picture)
    if picture.format not in DEPTH:
        raise PictureError(
            f"has depth encoding {picture.format[:20]!r}; known are {', '.join(DEPTH)}"
        )
    return _rows(picture, np.dtype(DEPTH[picture.format]), 1)[..., 0]


def _rows(picture: Picture, dtype: np.dtype, channels: int) -> np.ndarray:
    """(rows, columns, channels) of a raw image, padding left out, in native byte order."""
    height, width = picture.height, picture.width
    if height <= 0 or width <= 0 or height * width > MOST_PIXELS:
        raise PictureError(f"has {width} x {height} pixels")
    least = width * channels * dtype.itemsize
    step = picture.step or least
    # The last row may come without its padding.
    if step < least or len(picture.data) < step * (height - 1) + least:
        raise PictureError(
            f"has {len(picture.data)} bytes for {height} rows of {step}, a row of {width} pixels "
            f"needs {least}"
        )
    if len(picture.data) > step * height:
        raise PictureError(f"has {len(picture.data)} bytes for {height} rows of {step}")
    data = np.frombuffer(picture.data.ljust(step * height, b"\0"), np.uint8).reshape(height, step)
    order = ">" if picture.big_endian else "<"
    pixels = np.ascontiguousarray(data[:, :least]).view(dtype.newbyteorder(order))
    return pixels.reshape(height, width, channels).astype(dtype)


def _png_depth(picture: Picture) -> UInt16[np.ndarray, "rows columns"]:
    """A plain PNG file of 16-bit depth."""
    if not is_png(picture.data):
        raise PictureError(f"has format {picture.format[:40]!r}, which is no depth")
    pixels = decoded_file(picture.data, color=False)
    if pixels is None:
        raise PictureError("is cut or damaged inside")
    if not png_is_depth(picture.data) or pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise PictureError("is a PNG of colours, not of 16-bit depth")
    return pixels


def _decompressed(picture: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    if not (is_png(picture.data) or is_jpeg(picture.data)):
        raise PictureError(f"has format {picture.format[:40]!r}; known are jpeg and png")
    pixels = decoded_file(picture.data, color=True)
    if pixels is None:
        raise PictureError("is cut or damaged inside")
    if _channels_are_rgb(picture.format):
        return np.ascontiguousarray(pixels)
    return np.ascontiguousarray(pixels[..., ::-1])


def _channels_are_rgb(form: str) -> bool:
    """Whether the compressed picture's first channel is blue in truth, as the format may say.

    image_transport writes "<encoding>; jpeg compressed <encoding in the file>": a file that was
    written from RGB without swapping says "compressed rgb8", and its red and blue are exchanged.
    """
    return re.search(r"compressed\s+rgb8", form) is not None
