"""Dual contouring of a labelled solid: one vertex a cell, one quad a crossed grid edge.

Axes in shapes: `edges` crossed grid edges, `cells` cells that the surface crosses. All lengths are
in cells of the lattice. Vertices stay strictly inside their cells, and a quad is cut along a
diagonal only when both triangles stay inside its envelope: the four tetrahedra that the grid edge
spans with neighbouring cell vertices (Ju and Udeshi 2006). Envelopes of different edges do not
overlap, so the mesh cannot cut itself. Where neither diagonal fits, a fan around the crossing does.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int, UInt8

from doughdata.mesh.repair import CORNERS, cell_codes
from doughdata.mesh.solid import Solid

__all__ = ["Contour", "contour"]

CLAMP = 0.02  # [cells], least distance of a vertex from the faces of its cell
SHIFT_MAX = 0.4  # [cells], furthest that vertices move to match a volume
VOLUME_ERROR = 5e-4  # relative, at which the shifting ends
BLUR_POWER = 8  # how much a longer gradient counts against a shorter one
SLACK = 1e-6  # envelope tests keep this clear of their limits


@dataclass(frozen=True, slots=True, kw_only=True)
class Contour:
    """All components' meshes in one: vertices and faces, each in the order of the labels."""

    vertices: Float64[np.ndarray, "vertices 3"]  # [cells], lattice of the solid
    faces: Int[np.ndarray, "faces 3"]
    vertex_labels: UInt8[np.ndarray, " vertices"]
    face_labels: UInt8[np.ndarray, " faces"]
    shift: Float64[np.ndarray, " components"]  # [cells] by which the surface lies outside field = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Crossings:
    """Grid edges with a sign change, and the cells around them."""

    low: Int[np.ndarray, "edges 3"]  # node at the lower end
    axis: Int[np.ndarray, " edges"]
    fraction: Float[np.ndarray, " edges"]  # of the way to the upper end
    normal: Float[np.ndarray, "edges 3"]  # unit, outward
    cells: Int[np.ndarray, "edges 4"]  # around the axis, counter-clockwise
    oriented: Int[np.ndarray, "edges 4"]  # the same, counter-clockwise seen from outside


def contour(solid: Solid, *, regularisation: float) -> Contour:
    """Closed, manifold, outward-oriented surface of every component.

    Args:
        solid: well-composed, no cell with nodes of two labels (see build_solid).
        regularisation: weight of the crossings' mean against their tangent planes; 0.05 keeps
            edges sharp; infinity puts vertices at the mean, which is naive surface nets.
    """
    codes = cell_codes(solid.field < 0.0)
    flat = np.flatnonzero((codes != 0) & (codes != 255))
    cells = np.stack(np.unravel_index(flat, codes.shape), axis=1)
    labels = np.min([solid.labels[tuple((cells + corner).T)] for corner in CORNERS], axis=0)
    order = np.argsort(labels, kind="stable")
    flat, cells, labels = flat[order], cells[order], labels[order]
    lookup = np.full(codes.size, -1, np.int64)
    lookup[flat] = np.arange(len(flat))
    crossings = _find_crossings(solid.field, lookup.reshape(codes.shape))
    vertices, normals = _place_vertices(crossings, cells, regularisation)
    vertices, shift = _match_volume(vertices, crossings, normals, cells, labels, solid.volumes)
    return _triangulate(vertices, crossings, labels, shift)


def _find_crossings(
    field: Float[np.ndarray, "nx ny nz"], lookup: Int[np.ndarray, "cx cy cz"]
) -> _Crossings:
    """All crossed grid edges; the cells around each counter-clockwise about its axis."""
    inside = field < 0.0
    lows, axes, rings = [], [], []
    for axis in range(3):
        here = tuple(slice(0, -1) if a == axis else slice(None) for a in range(3))
        there = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        low = np.argwhere(inside[here] != inside[there])
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ring = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = low.copy()
            cell[:, u] -= du
            cell[:, v] -= dv
            ring.append(lookup[tuple(cell.T)])
        lows.append(low)
        axes.append(np.full(len(low), axis))
        rings.append(np.stack(ring, axis=1))
    low, axis = np.concatenate(lows), np.concatenate(axes)
    high = low.copy()
    high[np.arange(len(low)), axis] += 1
    at_low, at_high = field[tuple(low.T)], field[tuple(high.T)]
    fraction = (at_low / (at_low - at_high)).astype(np.float64)
    normal = _crossing_normals(_gradient(field, low), _gradient(field, high), fraction)
    cells = np.concatenate(rings)
    oriented = np.where((at_low < 0.0)[:, None], cells, cells[:, [0, 3, 2, 1]])
    return _Crossings(
        low=low, axis=axis, fraction=fraction, normal=normal, cells=cells, oriented=oriented
    )


def _crossing_normals(
    low: Float64[np.ndarray, "edges 3"],
    high: Float64[np.ndarray, "edges 3"],
    fraction: Float[np.ndarray, " edges"],
) -> Float64[np.ndarray, "edges 3"]:
    """Unit normals from the gradients at both ends.

    Across an edge of the solid a central difference mixes two faces and comes out short, so the
    longer gradient counts more.
    """
    lengths = [np.maximum(np.sqrt((g**2).sum(axis=1)), 1e-9) for g in (low, high)]
    ratio = np.clip(lengths[1] / lengths[0], 0.1, 10.0) ** BLUR_POWER
    share = fraction * ratio / (1.0 - fraction + fraction * ratio)
    normal = low * ((1.0 - share) / lengths[0])[:, None] + high * (share / lengths[1])[:, None]
    length = np.sqrt((normal**2).sum(axis=1, keepdims=True))
    return normal / np.maximum(length, 1e-9)


def _gradient(
    field: Float[np.ndarray, "nx ny nz"], nodes: Int[np.ndarray, "edges 3"]
) -> Float64[np.ndarray, "edges 3"]:
    """Central differences at nodes off the border."""
    strides = np.array([field.shape[1] * field.shape[2], field.shape[2], 1])
    flat, index = field.reshape(-1), nodes @ strides
    return np.stack([flat[index + s] - flat[index - s] for s in strides], axis=1, dtype=np.float64)


def _place_vertices(
    crossings: _Crossings, cells: Int[np.ndarray, "cells 3"], regularisation: float
) -> tuple[Float64[np.ndarray, "cells 3"], Float64[np.ndarray, "cells 3"]]:
    """Vertex of every cell, strictly inside it, and its mean normal."""
    count = len(cells)
    owner = crossings.cells.reshape(-1)
    which = np.repeat(np.arange(len(crossings.axis)), 4)
    point = crossings.low.astype(np.float64)
    point[np.arange(len(point)), crossings.axis] += crossings.fraction
    number = np.bincount(owner, minlength=count)

    def total(values: Float64[np.ndarray, " edges"]) -> Float64[np.ndarray, " cells"]:
        return np.bincount(owner, values[which], count) + 0.0  # floats even when empty

    mean = np.stack([total(p) for p in point.T], axis=1) / number[:, None]
    normal = np.stack([total(n) for n in crossings.normal.T], axis=1)
    length = np.sqrt((normal**2).sum(axis=1, keepdims=True))
    vertices = mean
    if math.isfinite(regularisation):
        vertices = mean + _sharpened(crossings.normal, point, mean, total, regularisation)
    return _clamp(vertices, cells), normal / np.maximum(length, 1e-9)


def _sharpened(
    n: Float64[np.ndarray, "edges 3"],
    point: Float64[np.ndarray, "edges 3"],
    mean: Float64[np.ndarray, "cells 3"],
    total: Callable[[Float64[np.ndarray, " edges"]], Float64[np.ndarray, " cells"]],
    regularisation: float,
) -> Float64[np.ndarray, "cells 3"]:
    """Step from the mean to the least of the quadratic error function; `total` sums per cell."""
    offset = (n * point).sum(axis=1)
    A = {(i, j): total(n[:, i] * n[:, j]) for i in range(3) for j in range(i, 3)}
    b = np.stack([total(n[:, i] * offset) for i in range(3)], axis=1)
    for i in range(3):
        for j in range(3):
            b[:, i] -= A[min(i, j), max(i, j)] * mean[:, j]
        A[i, i] += regularisation
    return _solve(A, b)


def _solve(
    A: dict[tuple[int, int], Float64[np.ndarray, " cells"]], b: Float64[np.ndarray, "cells 3"]
) -> Float64[np.ndarray, "cells 3"]:
    """Symmetric positive definite 3x3 systems by the adjugate."""
    xx, xy, xz, yy, yz, zz = (A[k] for k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    p, q, r = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    s, t, w = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * p + xy * q + xz * r
    x, y, z = b.T
    rows = (p * x + q * y + r * z, q * x + s * y + t * z, r * x + t * y + w * z)
    return np.stack(rows, axis=1) / determinant[:, None]


def _clamp(
    vertices: Float64[np.ndarray, "cells 3"], cells: Int[np.ndarray, "cells 3"]
) -> Float64[np.ndarray, "cells 3"]:
    return np.clip(vertices, cells + CLAMP, cells + (1.0 - CLAMP))


def _match_volume(
    vertices: Float64[np.ndarray, "cells 3"],
    crossings: _Crossings,
    normals: Float64[np.ndarray, "cells 3"],
    cells: Int[np.ndarray, "cells 3"],
    labels: UInt8[np.ndarray, " cells"],
    volumes: Float64[np.ndarray, " components"],
) -> tuple[Float64[np.ndarray, "cells 3"], Float64[np.ndarray, " components"]]:
    """Move vertices along their normals until each component has its volume; cells hold them."""
    quads = crossings.oriented
    owner = labels[quads[:, 0]]
    count = len(volumes)
    moved = vertices
    shift = np.zeros(count)
    for _ in range(6):
        a, b, c, d = (moved[quads[:, i]] for i in range(4))
        across = 0.5 * np.cross(c - a, d - b)
        volume = np.bincount(owner, (across * (a + b + c + d)).sum(axis=1) / 12.0, count)
        if (np.abs(volume - volumes) <= VOLUME_ERROR * volumes).all():
            break
        area = np.bincount(owner, np.sqrt((across**2).sum(axis=1)), count)
        shift += (volumes - volume) / np.maximum(area, 1e-9)
        shift = np.clip(shift, -SHIFT_MAX, SHIFT_MAX)
        moved = _clamp(vertices + shift[labels, None] * normals, cells)
    return moved, shift


def _triangulate(
    vertices: Float64[np.ndarray, "cells 3"],
    crossings: _Crossings,
    labels: UInt8[np.ndarray, " cells"],
    shift: Float64[np.ndarray, " components"],
) -> Contour:
    """Cut every quad along a diagonal that stays in its envelope, else fan it."""
    ring = _local(vertices, crossings)
    first, second = _diagonal_error(ring, crossings, 0), _diagonal_error(ring, crossings, 1)
    quads = crossings.oriented
    fan = ~np.isfinite(np.minimum(first, second))
    one, two = quads[~fan & (first <= second)], quads[~fan & (first > second)]
    centre = len(vertices) + np.arange(int(fan.sum()))
    point = crossings.low[fan].astype(np.float64)
    point[np.arange(len(point)), crossings.axis[fan]] += np.clip(
        crossings.fraction[fan], CLAMP, 1.0 - CLAMP
    )
    faces = [one[:, [0, 1, 2]], one[:, [0, 2, 3]], two[:, [0, 1, 3]], two[:, [1, 2, 3]]]
    faces.extend(
        np.stack([centre, quads[fan, i], quads[fan, (i + 1) % 4]], axis=1) for i in range(4)
    )
    faces = np.concatenate(faces)
    vertex_labels = np.concatenate([labels, labels[quads[fan, 0]]])
    order = np.argsort(vertex_labels, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    face_labels = vertex_labels[faces[:, 0]]
    face_order = np.argsort(face_labels, kind="stable")
    return Contour(
        vertices=np.concatenate([vertices, point])[order],
        faces=rank[faces[face_order]],
        vertex_labels=vertex_labels[order],
        face_labels=face_labels[face_order],
        shift=shift,
    )


def _local(
    vertices: Float64[np.ndarray, "cells 3"], crossings: _Crossings
) -> Float64[np.ndarray, "4 3 edges"]:
    """Corners of each quad in the frame of its grid edge: across u, across v, along the edge."""
    relative = vertices[crossings.cells] - crossings.low[:, None, :]
    turn = (crossings.axis[:, None] + np.array([1, 2, 0])) % 3
    local = np.take_along_axis(relative, turn[:, None, :], axis=2)
    return np.ascontiguousarray(local.transpose(1, 2, 0))


def _diagonal_error(
    ring: Float64[np.ndarray, "4 3 edges"], crossings: _Crossings, start: int
) -> Float64[np.ndarray, " edges"]:
    """Distance [cells] of the cut quad from the crossing, infinite where it leaves its envelope.

    The diagonal runs from corner `start` to the opposite one. Seen along the grid edge, the edge
    pierces one of the two triangles; `third` is that one's other corner and `middle` the last one.
    Inside the envelope the pierced point lies on the edge, and the diagonal passes through the
    triangle between the edge and `middle`.
    """
    a, c = ring[start], ring[start + 2]
    before, after = ring[start + 1], ring[(start + 3) % 4]
    side = _cross(a, c) > 0.0
    middle = np.where(side, before, after)
    third = np.where(side, after, before)
    weights = np.stack([_cross(c, third), _cross(third, a), _cross(a, c)])
    with np.errstate(divide="ignore", invalid="ignore"):
        height = (weights * np.stack([a[2], c[2], third[2]])).sum(axis=0) / weights.sum(axis=0)
        from_a, from_c = _cross(a, middle), _cross(c, middle)
        along = from_a / (from_a - from_c)
        hit = a + along * (c - a)
        reach = (hit[:2] * middle[:2]).sum(axis=0) / (middle[:2] ** 2).sum(axis=0)
        bottom = reach * middle[2]
        fits = (height > SLACK) & (height < 1.0 - SLACK) & (reach < 1.0 - SLACK)
        fits &= (hit[2] > bottom + SLACK) & (hit[2] < bottom + 1.0 - reach - SLACK)
    return np.where(fits, np.abs(height - crossings.fraction), np.inf)


def _cross(
    a: Float64[np.ndarray, "3 edges"], b: Float64[np.ndarray, "3 edges"]
) -> Float64[np.ndarray, " edges"]:
    """Area spanned across the edge."""
    return a[0] * b[1] - a[1] * b[0]
