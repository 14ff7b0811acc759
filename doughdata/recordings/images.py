"""Pixels of an image message: colour as RGB, depth as it was stored."""

import re
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from doughdata.recordings.compressed_depth import decode_compressed_depth
from doughdata.recordings.pictures import Picture, PictureError
from doughdata.recordings.png import png_is_whole
from doughdata.registry import require_package

__all__ = ["decode_colour", "decode_depth", "holds_depth", "image_size"]

MOST_PIXELS = 1 << 26
# Encoding -> bytes a pixel, and which of them are red, green, blue.
COLOUR = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8uc3": (3, (2, 1, 0)),  # OpenCV's order, as cv_bridge has it
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8uc4": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
    "8uc1": (1, (0, 0, 0)),
}
DEPTH = {"16uc1": np.uint16, "mono16": np.uint16, "32fc1": np.float32}
COMPRESSED_DEPTH = "compresseddepth"
JPEG_TAIL = 1024  # bytes that some cameras leave behind the end of a picture


def holds_depth(picture: Picture) -> bool:
    """Whether an image claims to be depth. mono16 may be, if the user says so."""
    if picture.compressed:
        return COMPRESSED_DEPTH in picture.format
    return picture.format in ("16uc1", "32fc1")


def decode_colour(picture: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    """RGB pixels of a raw, JPEG or PNG image.

    Raises:
        PictureError: another encoding, no pixels, or data that disagree with its size.
    """
    if picture.compressed:
        return _decompressed(picture)
    if picture.format not in COLOUR:
        raise PictureError(
            f"has colour encoding {picture.format[:20]!r}; known are {', '.join(COLOUR)}, jpeg, png"
        )
    channels, order = COLOUR[picture.format]
    pixels = _rows(picture, np.dtype(np.uint8), channels)
    return np.ascontiguousarray(pixels[..., order])


def decode_depth(
    picture: Picture,
) -> UInt16[np.ndarray, "rows columns"] | Float32[np.ndarray, "rows columns"]:
    """Depth pixels as stored: 16-bit units, or float metres (NaN or 0 = invalid).

    Raises:
        PictureError: another encoding, no pixels, or data that disagree with its size.
    """
    if picture.compressed:
        if COMPRESSED_DEPTH not in picture.format:
            raise PictureError(f"has format {picture.format[:40]!r}, which is no depth")
        return decode_compressed_depth(picture.data, picture.format)
    if picture.format not in DEPTH:
        raise PictureError(
            f"has depth encoding {picture.format[:20]!r}; known are {', '.join(DEPTH)}"
        )
    return _rows(picture, np.dtype(DEPTH[picture.format]), 1)[..., 0]


def image_size(picture: Picture) -> tuple[int, int]:
    """(height, width); of compressed images by decoding them. Raises as the decoders do."""
    if not picture.compressed:
        return picture.height, picture.width
    pixels = decode_depth(picture) if holds_depth(picture) else decode_colour(picture)
    return pixels.shape[0], pixels.shape[1]


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


def _decompressed(picture: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    """OpenCV gives BGR. Files that are cut are refused: it would fill the rest with grey."""
    cv2: Any = require_package("cv2", extra="mcap")
    data = picture.data
    if data.startswith(b"\x89PNG"):
        whole = png_is_whole(data)
    elif data.startswith(b"\xff\xd8"):
        whole = data.rfind(b"\xff\xd9") > len(data) - JPEG_TAIL
    else:
        raise PictureError(f"has format {picture.format[:40]!r}; known are jpeg and png")
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if whole else None
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
