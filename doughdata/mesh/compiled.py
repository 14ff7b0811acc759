"""Loops over points and what lies around them, compiled by numba.

The only compiled code of the mesher. Lengths are in cells: node (i, j, k) is at (i, j, k). Machine
code is kept in `NUMBA_CACHE_DIR` if that is set, else beside this file, else in the user's cache.
No sum is reordered.
"""

from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64
from numba import njit

__all__ = ["nearest_points", "spread_distance", "spread_nearest"]


FAST = {"nnan"}  # no coordinate is not a number


@no_type_check
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, or take the machine code of an earlier process."""
    try:
        return njit(cache=True, fastmath=FAST)(function)
    except RuntimeError:  # no folder that can be written to: compiled by every process
        return njit(fastmath=FAST)(function)


@compiled
@no_type_check
def spread_nearest(
    points: Float64[np.ndarray, "points 3"], shape: tuple[int, int, int], reach: float
) -> tuple[Float64[np.ndarray, "nx ny nz"], Int32[np.ndarray, "nx ny nz"]]:
    """Distance of every node to the nearest point, and which; `reach` and -1 where none is near."""
    square = np.full(shape, reach * reach)
    which = np.full(shape, -1, np.int32)
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        for i in range(max(0, int(np.ceil(x - reach))), min(shape[0], int(x + reach) + 1)):
            wide = np.sqrt(max(reach * reach - (i - x) ** 2, 0.0))
            for j in range(max(0, int(np.ceil(y - wide))), min(shape[1], int(y + wide) + 1)):
                rest = (i - x) ** 2 + (j - y) ** 2
                half = np.sqrt(max(reach * reach - rest, 0.0))
                for k in range(max(0, int(np.ceil(z - half))), min(shape[2], int(z + half) + 1)):
                    if rest + (k - z) ** 2 < square[i, j, k]:
                        square[i, j, k] = rest + (k - z) ** 2
                        which[i, j, k] = p
    return np.sqrt(square), which


@compiled
@no_type_check
def spread_distance(
    points: Float64[np.ndarray, "points 3"], shape: tuple[int, int, int], reach: float
) -> Float32[np.ndarray, "nx ny nz"]:
    """Distance of every node to the nearest point, or `reach` where none is near.

    Raises:
        ValueError: a point lies more than half a cell outside of the lattice.
    """
    pad = int(np.ceil(reach))
    wide = (shape[0] + 2 * pad, shape[1] + 2 * pad, shape[2] + 2 * pad)
    square = np.full(wide, np.float32(reach * reach))
    flat = square.reshape(-1)
    steps = np.arange(-pad, pad + 1).astype(np.float32)
    halves = np.empty((2 * pad + 1, 2 * pad + 1), np.int64)  # of the rows around a point
    for a in range(2 * pad + 1):
        for b in range(2 * pad + 1):
            rest = reach**2 - max(abs(a - pad) - 0.5, 0) ** 2 - max(abs(b - pad) - 0.5, 0) ** 2
            halves[a, b] = min(int(np.sqrt(rest) + 0.5), pad) if rest > 0 else -1
    for p in range(len(points)):
        x, y, z = points[p, 0] + pad, points[p, 1] + pad, points[p, 2] + pad
        i0, j0, k0 = int(x + 0.5), int(y + 0.5), int(z + 0.5)
        if (
            min(i0, j0, k0) < pad
            or i0 - pad >= shape[0]
            or j0 - pad >= shape[1]
            or k0 - pad >= shape[2]
        ):
            raise ValueError("a point lies outside of the lattice")
        along = np.float32(k0 - z)
        for a in range(2 * pad + 1):
            for b in range(2 * pad + 1):
                half = halves[a, b]
                if half < 0:
                    continue
                i, j = i0 + a - pad, j0 + b - pad
                rest = np.float32((i - x) ** 2 + (j - y) ** 2)
                row = np.uintp((i * wide[1] + j) * wide[2] + k0 - half)
                first = np.uintp(pad - half)
                for k in range(np.uintp(2 * half + 1)):
                    away = along + steps[first + k]
                    new, old = rest + away * away, flat[row + k]
                    flat[row + k] = new if new < old else old
    return np.sqrt(square[pad : wide[0] - pad, pad : wide[1] - pad, pad : wide[2] - pad])


@compiled
@no_type_check
def nearest_points(
    points: Float64[np.ndarray, "points 3"],
    queries: Float64[np.ndarray, "queries 3"],
    count: int,
    cell: float,
) -> Int64[np.ndarray, "queries count"]:
    """The `count` nearest of at least as many points, nearest first, for each query.

    Points are sorted into cubes of size `cell`. A search first goes as far as the answer of the
    query before suggests, so neighbours should follow each other.
    """
    low, size, start, order = _sorted_into_cubes(points, cell)
    near = points[order]
    found = np.empty((len(queries), count), np.int64)
    squares, places = np.empty(count), np.empty(count, np.int64)
    reach = 0.0
    for q in range(len(queries)):
        x, y, z = queries[q]
        before = queries[max(q - 1, 0)]
        step = np.sqrt((x - before[0]) ** 2 + (y - before[1]) ** 2 + (z - before[2]) ** 2)
        reach += min(step, cell)
        number = 0
        while number < count:
            reach = max(reach, cell)
            number, worst = 0, reach * reach * (1 + 1e-9)
            k0, k1 = _cubes_within(z - low[2], reach, cell, size[2])
            i0, i1 = _cubes_within(x - low[0], reach, cell, size[0])
            j0, j1 = _cubes_within(y - low[1], reach, cell, size[1])
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    row = (i * size[1] + j) * size[2]
                    for p in range(start[row + k0], start[row + k1 + 1]):
                        square = (
                            (x - near[p, 0]) ** 2 + (y - near[p, 1]) ** 2 + (z - near[p, 2]) ** 2
                        )
                        if square < worst:
                            at = number if number < count else count - 1
                            number = at + 1
                            while at > 0 and squares[at - 1] > square:
                                squares[at], places[at] = squares[at - 1], places[at - 1]
                                at -= 1
                            squares[at], places[at] = square, p
                            if number == count:
                                worst = squares[count - 1]
            reach = np.sqrt(worst) if number == count else 1.6 * reach
        for at in range(count):
            found[q, at] = order[places[at]]
    return found


@compiled
@no_type_check
def _cubes_within(at: float, reach: float, cell: float, size: int) -> tuple[int, int]:
    """First and last of a row of cubes that a point may have neighbours in, or the nearest cube."""
    first = min(max(int(np.floor((at - reach) / cell)), 0), size - 1)
    last = min(max(int(np.floor((at + reach) / cell)), 0), size - 1)
    return first, last


@compiled
@no_type_check
def _sorted_into_cubes(
    points: Float64[np.ndarray, "points 3"], cell: float
) -> tuple[
    Float64[np.ndarray, " 3"],
    Int64[np.ndarray, " 3"],
    Int64[np.ndarray, " starts"],
    Int64[np.ndarray, " points"],
]:
    """Lowest corner, number of cubes along each axis, first place of each cube, order of points."""
    low, size = np.empty(3), np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = points[:, axis].min()
        size[axis] = int((points[:, axis].max() - low[axis]) / cell) + 1
    cube = np.empty(len(points), np.int64)
    start = np.zeros(size[0] * size[1] * size[2] + 1, np.int64)
    for p in range(len(points)):
        i, j, k = ((points[p] - low) / cell).astype(np.int64)
        cube[p] = (i * size[1] + j) * size[2] + k
        start[cube[p] + 1] += 1
    return low, size, np.cumsum(start), np.argsort(cube, kind="mergesort")
