"""Loops that last while balls around the particles grow: persistence on the alpha complex.

A union of balls of radius r has the homotopy type of the Delaunay simplices whose smallest empty
circumscribed ball is at most r (Edelsbrunner & Muecke 1994, "Three-dimensional alpha shapes"). A
hole of the dough is a loop that is there early and stays for long (Edelsbrunner, Letscher &
Zomorodian 2002, "Topological persistence and simplification"); pores are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from doughdata.topology.pairs import is_member

__all__ = ["AlphaComplex", "sparse_rank"]

FEWEST = 5  # particles of a tetrahedralisation
SHAKE = 1e-6  # by which points are moved
FLAT = 1e-9  # volume over cubed length below which a tetrahedron has no circumscribed ball


@dataclass(frozen=True, slots=True, kw_only=True)
class AlphaComplex:
    """Delaunay edges and triangles of points, each with the radius at which it appears."""

    count: int  # points
    solids: int  # tetrahedra
    triangles: Float64[np.ndarray, " triangles"]  # radii
    edges: Float64[np.ndarray, " edges"]
    ends: Int64[np.ndarray, "edges 2"]  # points of an edge, rising
    sides: Int64[np.ndarray, "triangles 3"]  # edges of a triangle
    beside: Int64[np.ndarray, "triangles 2"]  # tetrahedra of a triangle, -1 outside the hull

    @classmethod
    def of(cls, points: Float64[np.ndarray, "points 3"]) -> "AlphaComplex":
        """Tetrahedralise points, about one unit apart; radii come in that unit.

        Fewer than five points, and points of one plane, have no simplices.
        """
        if len(points) < FEWEST or np.linalg.matrix_rank(points - points.mean(axis=0)) < 3:
            return _empty(len(points))
        # Points of a regular grid lie on common spheres: no tetrahedralisation is the only one.
        points = points + np.random.default_rng(0).uniform(-SHAKE, SHAKE, points.shape)
        made = Delaunay(points)
        corners, across = made.simplices.astype(np.int64), made.neighbors.astype(np.int64)
        radius = _tetrahedron_radii(points[corners])
        own, face = np.nonzero(across < np.arange(len(corners))[:, None])  # each triangle once
        other = across[own, face]
        three = np.stack([corners[own, (face + k) % 4] for k in (1, 2, 3)], axis=1)
        back = (across[other] == own[:, None]).argmax(axis=1)
        tips = np.stack([corners[own, face], np.where(other < 0, -1, corners[other, back])], axis=1)
        beside = np.stack([own, other], axis=1)
        triangles = _triangle_radii(points, three, tips, radius, beside)
        pairs = np.sort(three[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        keys, sides = np.unique(pairs[:, 0] * len(points) + pairs[:, 1], return_inverse=True)
        ends = np.stack(np.divmod(keys, len(points)), axis=1)
        return cls(
            count=len(points),
            solids=len(corners),
            triangles=triangles,
            edges=_edge_radii(points, ends, sides, three, triangles),
            ends=ends,
            sides=sides.reshape(-1, 3),
            beside=beside,
        )

    def lasting(
        self, windows: Sequence[tuple[float, float]], *, without: Int64[np.ndarray, " pairs"]
    ) -> list[int]:
        """Loops that are there at a radius and not yet filled at a larger one, for each window.

        The rank of H1(complex at birth) -> H1(complex at death), over the field of two elements.
        Every window must lie in the one before, so that the numbers rise; between equal ones at
        both ends nothing is counted. Simplices with an edge in `without` (sorted keys of point
        pairs) are left out.
        """
        kept = ~is_member(self.ends[:, 0] * self.count + self.ends[:, 1], without)
        whole = np.asarray(kept[self.sides].all(axis=1))
        first = self._rank(*windows[0], kept, whole)
        last = self._rank(*windows[-1], kept, whole) if len(windows) > 1 else first
        if first == last:
            return [first] * len(windows)
        return [first, *(self._rank(*own, kept, whole) for own in windows[1:-1]), last]

    def _rank(
        self,
        birth: float,
        death: float,
        edges: Bool[np.ndarray, " edges"],
        triangles: Bool[np.ndarray, " triangles"],
    ) -> int:
        early = edges & (self.edges <= birth)
        cycles = int(early.sum()) - self.count + _parts(self.ends[early], self.count)
        filled = triangles & (self.triangles <= death)
        # Boundaries at death that lie in the complex at birth: all, less what takes late edges.
        sides = self.sides[filled]
        late = sparse_rank(np.where(early[sides], -1, sides))
        return cycles - (self._boundaries(filled) - late)

    def _boundaries(self, triangles: Bool[np.ndarray, " triangles"]) -> int:
        """Dimension of the boundaries of triangles: their number less that of closed surfaces.

        Those are the parts of the rest of space, less one (Alexander duality).
        """
        rest = self.beside[~triangles]
        rest = np.where(rest < 0, self.solids, rest)  # all that is outside the hull is one
        return int(triangles.sum()) - (_parts(rest, self.solids + 1) - 1)


def sparse_rank(columns: Int64[np.ndarray, "columns 3"]) -> int:
    """Rank over two elements of a matrix with up to three ones a column.

    A column lists its rows; -1 is no row. A column with one row takes that row out of all others,
    so that most of the matrix falls away; the little that is left is reduced column by column.
    """
    rank = 0
    columns = columns[(columns >= 0).any(axis=1)]
    while len(columns):
        single = (columns >= 0).sum(axis=1) == 1
        if not single.any():
            break
        rows = np.unique(columns[single].max(axis=1))
        rank += len(rows)
        taken = is_member(columns.ravel(), rows).reshape(columns.shape)
        columns = np.where(taken, -1, columns)
        columns = columns[(columns >= 0).any(axis=1)]
    lowest: dict[int, frozenset[int]] = {}
    for column in columns.tolist():
        left = frozenset(row for row in column if row >= 0)
        while left and (low := max(left)) in lowest:
            left = left ^ lowest[low]
        if left:
            lowest[max(left)] = left
    return rank + len(lowest)


def _empty(count: int) -> AlphaComplex:
    return AlphaComplex(
        count=count,
        solids=0,
        triangles=np.zeros(0),
        edges=np.zeros(0),
        ends=np.zeros((0, 2), np.int64),
        sides=np.zeros((0, 3), np.int64),
        beside=np.zeros((0, 2), np.int64),
    )


def _parts(pairs: Int[np.ndarray, "pairs 2"], count: int) -> int:
    """Connected parts of a graph of `count` nodes."""
    ones = np.ones(len(pairs), np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (count, count))
    return int(connected_components(graph, directed=False, return_labels=False))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def _tetrahedron_radii(
    corners: Float64[np.ndarray, "tetrahedra 4 3"],
) -> Float64[np.ndarray, " tetrahedra"]:
    """Radius of the circumscribed ball; infinite where the corners lie in a plane."""
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    aa, bb, cc = _dot(a, a), _dot(b, b), _dot(c, c)
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    volume = _dot(a, bc)
    top = np.sqrt(_square(aa[:, None] * bc + bb[:, None] * ca + cc[:, None] * ab))
    flat = np.abs(volume) < FLAT * np.maximum(np.maximum(aa, bb), cc) ** 1.5
    return np.where(flat, np.inf, top / np.where(flat, 1.0, 2 * np.abs(volume)))


def _square(a: np.ndarray) -> np.ndarray:
    return _dot(a, a)


def _triangle_radii(
    points: Float64[np.ndarray, "points 3"],
    three: Int64[np.ndarray, "triangles 3"],
    tips: Int64[np.ndarray, "triangles 2"],
    radius: Float64[np.ndarray, " tetrahedra"],
    beside: Int64[np.ndarray, "triangles 2"],
) -> Float64[np.ndarray, " triangles"]:
    """Radius of the circle if its ball holds neither tip beside it, else of the tetrahedra."""
    base = points[three[:, 0]]
    a, b = points[three[:, 1]] - base, points[three[:, 2]] - base
    aa, bb, normal = _dot(a, a), _dot(b, b), np.cross(a, b)
    wide = np.maximum(_square(normal), 1e-300)
    centre = np.cross(aa[:, None] * b - bb[:, None] * a, normal) / (2 * wide[:, None])
    square = _square(centre)
    away = _square(points[tips] - (base + centre)[:, None])
    inside = (away < square[:, None]) & (tips >= 0)
    nearest = np.where(beside >= 0, radius[beside], np.inf).min(axis=1)
    return np.where(inside.any(axis=1), nearest, np.sqrt(square))


def _edge_radii(
    points: Float64[np.ndarray, "points 3"],
    ends: Int64[np.ndarray, "edges 2"],
    sides: Int64[np.ndarray, " corners"],
    three: Int64[np.ndarray, "triangles 3"],
    triangles: Float64[np.ndarray, " triangles"],
) -> Float64[np.ndarray, " edges"]:
    """Half the length if the ball around it holds no tip of its triangles, else of those."""
    first, second = points[ends[:, 0]], points[ends[:, 1]]
    middle, square = (first + second) / 2, _square(second - first) / 4
    sides = sides.ravel()
    tip = points[three[:, [2, 0, 1]].ravel()]
    covered: Bool[np.ndarray, " corners"] = _square(tip - middle[sides]) < square[sides]
    inside = np.zeros(len(ends), dtype=bool)
    inside[sides[covered]] = True
    nearest = np.full(len(ends), np.inf)
    np.minimum.at(nearest, sides, np.repeat(triangles, 3))
    return np.where(inside, nearest, np.sqrt(square))
