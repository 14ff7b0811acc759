"""Whether a PNG file is whole. OpenCV fills what is missing and says nothing."""

import struct
from zlib import crc32

__all__ = ["png_is_whole"]

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def png_is_whole(data: bytes) -> bool:
    """Whether all chunks up to the last are there and fit their CRCs; bytes behind are ignored."""
    if not data.startswith(SIGNATURE):
        return False
    place = len(SIGNATURE)
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
