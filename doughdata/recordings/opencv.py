"""JPEG and PNG files through OpenCV, which alone would fill what is missing and say nothing."""

import struct
from typing import Any
from zlib import crc32

import numpy as np

from doughdata.registry import require_package

__all__ = ["MOST_PIXELS", "decoded_file", "is_jpeg", "is_png", "png_is_depth", "png_is_whole"]

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
MOST_PIXELS = 1 << 26
JPEG_END, JPEG_TAIL = b"\xff\xd9", 1024  # bytes that some cameras leave behind the end
SIZED = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of a JPEG frame, which say its size


def is_png(data: bytes) -> bool:
    """Whether a file begins like a PNG."""
    return data.startswith(PNG)


def is_jpeg(data: bytes) -> bool:
    """Whether a file begins like a JPEG."""
    return data.startswith(JPEG)


def decoded_file(data: bytes, *, color: bool) -> np.ndarray | None:
    """Pixels of a whole PNG or JPEG file; None if it is cut, damaged or too large.

    With `color` they are BGR, 8 bits a channel; without they are as they were stored.
    """
    cv2: Any = require_package("cv2", extra="mcap")
    if is_png(data):
        whole, size = png_is_whole(data), struct.unpack_from(">II", data.ljust(24, b"\0"), 16)
    else:
        whole, size = data.rfind(JPEG_END) > len(data) - JPEG_TAIL, _jpeg_size(data)
    if not whole or not 0 < size[0] * size[1] <= MOST_PIXELS:
        return None
    try:
        flags = cv2.IMREAD_COLOR if color else cv2.IMREAD_UNCHANGED
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except (cv2.error, MemoryError):
        return None


def png_is_whole(data: bytes) -> bool:
    """Whether all chunks up to the last are there and fit their CRCs; bytes behind are ignored."""
    if not is_png(data):
        return False
    place = len(PNG)
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        end = place + 8 + length
        if end + 4 > len(data) or struct.unpack_from(">I", data, end)[0] != crc32(
            data[place + 4 : end]
        ):
            return False
        if data[place + 4 : place + 8] == b"IEND":
            return True
        place = end + 4
    return False


def png_is_depth(data: bytes) -> bool:
    """Whether a PNG has one channel of 16 bits."""
    return is_png(data) and data[24:26] == bytes([16, 0])


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Rows and columns that a JPEG file claims; (0, 0) if it does not say."""
    place = len(JPEG)
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:  # a byte that fills up
            place += 1
            continue
        if marker in SIZED:
            return struct.unpack_from(">HH", data, place + 5)
        place += 2 + struct.unpack_from(">H", data, place + 2)[0]
    return 0, 0
