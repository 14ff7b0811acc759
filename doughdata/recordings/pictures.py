"""Image and camera messages of ROS 1, ROS 2 and Foxglove, brought to one form."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from doughdata.recordings.source import Message
from doughschemas import Intrinsics

__all__ = [
    "IMAGES",
    "INFOS",
    "VIDEOS",
    "Lens",
    "Picture",
    "PictureError",
    "frame_of",
    "lens_of",
    "picture_of",
    "stamp_of",
]

IMAGES = ("Image", "RawImage", "CompressedImage")  # kinds of topics, see `Topic.kind`
VIDEOS = ("CompressedVideo", "FFMPEGPacket")  # which are not decoded
LAST = 1 << 63  # [ns]; a stamp from here on is none
MOST_FOCAL, MOST_SHIFT = 1000, 100  # focal length and principal point, in widths of the picture
INFOS = ("CameraInfo", "CameraCalibration")


class PictureError(Exception):
    """An image or camera message that cannot be used; says why, in a few words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """An image as it was recorded, not decoded yet."""

    stamp: int  # [ns], of the sensor; 0 = not set
    frame: str  # id of the coordinate frame it was taken in; "" = not said
    format: str  # lower case; encoding of the pixels, or format of the compressed data
    data: bytes
    compressed: bool
    width: int = 0  # of raw images
    height: int = 0
    step: int = 0  # bytes a row, padding included
    big_endian: bool = False
    unit_known: bool = True  # whether the type of message fixes the unit of 16-bit depth


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """A camera's calibration: the pinhole part, and how far distortion bends the picture."""

    intrinsics: Intrinsics
    frame: str
    distortion: tuple[float, ...]
    model: str


def stamp_of(value: Any) -> int:
    """When a message was taken [ns]; 0 if it does not say."""
    header = getattr(value, "header", None)
    stamp = header.stamp if header is not None else getattr(value, "timestamp", None)
    if stamp is None:
        return 0
    for seconds, rest in (("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos")):
        if hasattr(stamp, seconds):
            stamp = int(getattr(stamp, seconds)) * 10**9 + int(getattr(stamp, rest))
    return stamp if isinstance(stamp, int) and abs(stamp) < LAST else 0


def frame_of(value: Any) -> str:
    """Coordinate frame of a message, without the slash that ROS 1 put before it."""
    header = getattr(value, "header", None)
    return str(getattr(header if header is not None else value, "frame_id", "")).lstrip("/")


def picture_of(message: Message, kind: str) -> Picture:
    """The image in a message of one of the kinds `IMAGES`.

    Raises:
        PictureError: the message was not decoded, or lacks a field.
    """
    if message.error:
        raise PictureError(message.error)
    value = message.value
    try:
        raw = {} if kind == "CompressedImage" else _raw_fields(value)
        return Picture(
            stamp=stamp_of(value),
            frame=frame_of(value),
            format=str(value.format if kind == "CompressedImage" else value.encoding).lower(),
            data=bytes(value.data),
            compressed=kind == "CompressedImage",
            unit_known=kind != "RawImage",  # Foxglove's type
            **raw,
        )
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise PictureError(f"is no image message ({error})") from error


def _raw_fields(value: Any) -> dict[str, Any]:
    return {
        "width": int(value.width),
        "height": int(value.height),
        "step": int(value.step),
        "big_endian": bool(getattr(value, "is_bigendian", False)),
    }


def lens_of(message: Message) -> Lens:
    """The calibration in a message of one of the kinds `INFOS`; `K` is used, not `P`.

    Raises:
        PictureError: not decoded, or no camera: numbers missing, not finite or not positive.
    """
    if message.error:
        raise PictureError(message.error)
    value = message.value
    try:
        matrix = np.array(_either(value, "k"), float).reshape(3, 3)
        distortion = tuple(float(x) for x in _either(value, "d"))
        width, height = int(value.width), int(value.height)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise PictureError(f"is no camera calibration ({error})") from error
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not all(map(math.isfinite, (fx, fy, cx, cy, *distortion))):
        raise PictureError("has numbers that are not finite")
    if fx <= 0 or fy <= 0:
        raise PictureError(f"is not calibrated (fx {fx:g}, fy {fy:g})")
    span = max(width, height)
    if not span / MOST_FOCAL < min(fx, fy) <= max(fx, fy) < span * MOST_FOCAL or (
        max(abs(cx), abs(cy)) > span * MOST_SHIFT
    ):
        raise PictureError(
            f"is no calibration of {width} x {height} pixels "
            f"(fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g})"
        )
    binning = max(int(getattr(value, "binning_x", 0)), int(getattr(value, "binning_y", 0)))
    roi = getattr(value, "roi", None)
    if binning > 1 or (roi is not None and (int(roi.width), int(roi.height)) not in _whole(value)):
        raise PictureError("describes a binned or cropped picture, which is not supported")
    return Lens(
        intrinsics=Intrinsics(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy),
        frame=frame_of(value),
        distortion=distortion,
        model=str(getattr(value, "distortion_model", "")),
    )


def _whole(value: Any) -> tuple[tuple[int, int], ...]:
    """Sizes of a region of interest that mean the whole picture."""
    return ((0, 0), (int(value.width), int(value.height)))


def _either(value: Any, name: str) -> Any:
    """A field that ROS 2 writes in lower case, ROS 1 and Foxglove in capitals."""
    return getattr(value, name) if hasattr(value, name) else getattr(value, name.upper())
