"""The part of depth images that shows the workspace, small enough to send to a browser."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64, UInt16

from doughdata.geometry import points_from_depth, project
from doughschemas import Camera, DepthViews

__all__ = ["RAMP", "DepthWindow", "depth_windows", "ramp_colours", "window_points"]

MARGIN = 0.6  # of the dough's extent, on each side: some table around it
RAMP = np.array(  # even stops of reversed viridis, near to far, as on the contact sheet
    [
        [0.993, 0.906, 0.144],
        [0.835, 0.886, 0.103],
        [0.668, 0.862, 0.196],
        [0.506, 0.829, 0.300],
        [0.361, 0.786, 0.388],
        [0.239, 0.736, 0.456],
        [0.154, 0.680, 0.504],
        [0.120, 0.622, 0.535],
        [0.129, 0.563, 0.551],
        [0.150, 0.504, 0.557],
        [0.174, 0.445, 0.558],
        [0.201, 0.384, 0.554],
        [0.232, 0.318, 0.545],
        [0.261, 0.247, 0.523],
        [0.280, 0.171, 0.480],
        [0.282, 0.090, 0.412],
        [0.267, 0.005, 0.329],
    ]
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthWindow:
    """A crop of one depth view, every `stride`-th pixel, with the camera that sees just it."""

    frame: int
    depth: UInt16[np.ndarray, "rows columns"]  # in the layer's unit, 0 = invalid
    camera: Camera
    stride: int


def depth_windows(
    views: DepthViews,
    positions: Float[np.ndarray, "*batch 3"],
    *,
    most_pixels: int = 3_000_000,
) -> list[DepthWindow]:
    """Crop every view to the dough's surroundings.

    `positions` [m], world, are all the dough of the scene. The stride is the smallest, the same for
    all views, that keeps their pixels together under `most_pixels`.
    """
    low, high = positions.reshape(-1, 3).min(axis=0), positions.reshape(-1, 3).max(axis=0)
    reach = MARGIN * (high - low).max() * np.array([1, 1, 0])
    corners = np.stack(
        np.meshgrid(*np.stack([low - reach, high + reach], axis=1), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    boxes = [_pixels(corners, camera) for camera in views.cameras]
    total = sum((rows.stop - rows.start) * (cols.stop - cols.start) for rows, cols in boxes)
    stride = max(1, math.ceil(math.sqrt(total / most_pixels)))
    windows = []
    for image, frame, camera, (rows, columns) in zip(
        views.depth, views.frame_index, views.cameras, boxes, strict=True
    ):
        crop = image[rows, columns][::stride, ::stride]
        if crop.size:
            seen = _windowed(camera, rows.start, columns.start, stride, crop.shape)
            windows.append(DepthWindow(frame=int(frame), depth=crop, camera=seen, stride=stride))
    return windows


def window_points(window: DepthWindow, *, unit: float) -> Float64[np.ndarray, "points 3"]:
    """World points [m] of the valid pixels, row by row; `unit` [m] is the layer's."""
    return points_from_depth(window.depth * np.float64(unit), window.camera)


def ramp_colours(values: Float[np.ndarray, " points"]) -> Float64[np.ndarray, "points 3"]:
    """RGB of values between 0 and 1; what lies outside gets the end's colour."""
    at = np.linspace(0, 1, len(RAMP))
    return np.stack([np.interp(values, at, RAMP[:, k]) for k in range(3)], axis=1)


def _pixels(corners: Float64[np.ndarray, "corners 3"], camera: Camera) -> tuple[slice, slice]:
    """Rows and columns that hold the points; all, where one lies behind the camera."""
    k = camera.intrinsics
    pixels, depth = project(corners, camera)
    if (depth <= 0).any():
        return slice(0, k.height), slice(0, k.width)
    limit = np.array([k.width, k.height])
    first = np.clip(np.floor(pixels.min(axis=0)), 0, limit).astype(int)
    last = np.clip(np.ceil(pixels.max(axis=0)) + 1, first, limit).astype(int)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def _windowed(camera: Camera, row: int, column: int, stride: int, shape: tuple[int, ...]) -> Camera:
    """The camera whose pixel (i, j) is pixel (column + stride i, row + stride j) of `camera`."""
    k = camera.intrinsics
    inner = replace(
        k,
        width=shape[1],
        height=shape[0],
        fx=k.fx / stride,
        fy=k.fy / stride,
        cx=(k.cx - column) / stride,
        cy=(k.cy - row) / stride,
    )
    return replace(camera, intrinsics=inner)
