"""RVL: run-length and variable-length coding of 16-bit depth (A. D. Wilson, "Fast Lossless Depth
Image Compression", ISS 2017). No package with a permissive licence decodes it from Python.

A stream of 4-bit groups, the first in the high bits of a little-endian 32-bit word. A number is
written in groups of three bits, least significant first; the fourth bit says that more follow.
Numbers come as: zeros, non-zeros, then one zigzag difference a non-zero pixel, and again.
"""

import numpy as np
from jaxtyping import Int64, UInt8, UInt16

from doughdata.recordings.pictures import PictureError

__all__ = ["decode_rvl", "encode_rvl"]


def decode_rvl(data: bytes, count: int) -> UInt16[np.ndarray, " pixels"]:
    """`count` pixels.

    Raises:
        PictureError: the data end early, or say more pixels than there are.
    """
    numbers = _numbers(np.frombuffer(data[: len(data) // 4 * 4], np.uint8))
    out = np.zeros(count, np.uint16)
    place = done = previous = 0
    while done < count:
        if place + 2 > len(numbers):
            raise PictureError("is cut")
        zeros, run = int(numbers[place]), int(numbers[place + 1])
        place, done = place + 2, done + zeros
        if done + run > count or place + run > len(numbers) or (zeros == run == 0):
            raise PictureError("is damaged inside")
        zigzag = numbers[place : place + run]
        values = previous + np.cumsum((zigzag >> 1) ^ -(zigzag & 1))
        if run:
            if values.min() < 0 or values.max() > 65535:
                raise PictureError("is damaged inside")
            previous = int(values[-1])
            out[done : done + run] = values
        place, done = place + run, done + run
    return out


def encode_rvl(pixels: UInt16[np.ndarray, " pixels"]) -> bytes:
    """The inverse of `decode_rvl`."""
    values = pixels.astype(np.int64)
    numbers: list[int] = []
    done = previous = 0
    while done < len(values):
        rest = values[done:] != 0
        zeros = int(np.argmax(rest)) if rest.any() else len(rest)
        filled = ~rest[zeros:]
        run = int(np.argmax(filled)) if filled.any() else len(filled)
        part = values[done + zeros : done + zeros + run]
        steps = np.diff(part, prepend=previous)
        numbers += [zeros, run, *((steps << 1) ^ (steps >> 63)).tolist()]
        previous = int(part[-1]) if run else previous
        done += zeros + run
    return _groups(numbers)


def _numbers(data: UInt8[np.ndarray, " bytes"]) -> Int64[np.ndarray, " numbers"]:
    """All numbers of a stream; a last one that never ends is left out."""
    words = data.reshape(-1, 4)[:, ::-1].reshape(-1)
    groups = np.stack([words >> 4, words & 15], axis=1).reshape(-1).astype(np.int64)
    last = np.flatnonzero(groups < 8)  # the group that ends a number
    if len(last) == 0:
        return np.zeros(0, np.int64)
    groups = groups[: last[-1] + 1]
    first = np.concatenate([[0], last[:-1] + 1])
    place = np.arange(len(groups)) - np.repeat(first, last - first + 1)
    parts = np.where(place < 20, (groups & 7) << np.minimum(3 * place, 57), 0)
    return np.add.reduceat(parts, first)


def _groups(numbers: list[int]) -> bytes:
    groups: list[int] = []
    for number in numbers:
        while number > 7:
            groups.append(number & 7 | 8)
            number >>= 3
        groups.append(number)
    groups += [0] * (-len(groups) % 8)
    pairs = np.array(groups, np.uint8).reshape(-1, 2)
    return ((pairs[:, 0] << 4) | pairs[:, 1]).reshape(-1, 4)[:, ::-1].tobytes()
