"""Sharp convex edges of a signed-distance field of particles.

The surface lies half a spacing outside the outermost particles, so every convex edge comes out as a
fillet of that radius, worn by the particles' scatter. Here the field near edges is made anew from
planes that are fitted below the surface, where level sets of a distance are still sharp. Lengths
are in cells.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from doughdata.mesh.compiled import nearest_points, spread_distance
from doughdata.registry import require_package

__all__ = ["sharpen"]

# in spacings: the layer of nodes that give planes, and the nodes that get a new distance
LAYER = (-0.8, -0.2)
BAND = (-0.5, 1.0)
FIT_REACH = 2.5  # spacings; planes are averaged with those of similar direction this near
EDGE_REACH = 1.9  # spacings from a plane beside an edge; beyond it the field stays
LIMIT = 0.5  # spacings, furthest that the surface moves outward
SIMILAR = 0.35  # difference of unit normals at which the weight in a fit has fallen to 1/e
TURN = 0.5  # cosine; planes that differ by more than 60 degrees within FIT_REACH make an edge
PLANES = 18  # nearest planes that a node looks at
SHARE = 2.0 / 3.0  # of them that lie below the result: a face is seen if a third belong to it
GRADIENT = (0.85, 1.15)  # length of a distance's gradient where no medial surface is near


def sharpen(
    field: Float32[np.ndarray, "nx ny nz"], *, per: float
) -> Float32[np.ndarray, "nx ny nz"] | None:
    """The field with fillets filled up to the planes of the faces beside them.

    Near an edge a node gets the distance to the solid that its nearest planes bound: the greatest
    of their distances, save that the upper third counts as noise. It is never more than before.

    Args:
        field: signed distance, negative inside, exact within two cells of the surface.
        per: cells of the lattice a particle spacing.

    Returns:
        None where there is no edge.
    """
    spatial = require_package("scipy.spatial", extra="sim")
    point, normal, distance = _planes(field, per)
    if len(point) < PLANES:
        return None
    a, b = spatial.cKDTree(point).query_pairs(FIT_REACH * per, output_type="ndarray").T
    edge = np.unique(np.stack([a, b])[:, (normal[a] * normal[b]).sum(axis=1) < TURN])
    if not len(edge):
        return None
    flat, reach = field.reshape(-1), EDGE_REACH * per
    beside = spread_distance(point[edge], field.shape, reach).reshape(-1) < reach
    index = np.flatnonzero(beside & (flat > BAND[0] * per) & (flat < BAND[1] * per))
    nodes = np.stack(np.unravel_index(index, field.shape), axis=1).astype(float)
    normal, distance = _averaged(point, normal, distance, np.r_[a, b], np.r_[b, a])
    offset = distance - (normal * point).sum(axis=1)
    near = nearest_points(point, nodes, PLANES, 2.0 * per)
    value = np.einsum("nki,ni->nk", normal[near], nodes) + offset[near]
    rank = int(SHARE * (PLANES - 1))
    value = np.partition(value, rank, axis=1)[:, rank]
    result = field.copy()
    old = flat[index]
    result.reshape(-1)[index] = np.clip(value, old - LIMIT * per, old)
    return result


def _planes(
    field: Float32[np.ndarray, "nx ny nz"], per: float
) -> tuple[
    Float64[np.ndarray, "planes 3"], Float64[np.ndarray, "planes 3"], Float64[np.ndarray, " planes"]
]:
    """Point, unit normal, distance [cells] there; one a block of 2x2x2 nodes and main direction."""
    flat = field.reshape(-1)
    strides = np.array([field.shape[1] * field.shape[2], field.shape[2], 1])
    index = np.flatnonzero((flat > LAYER[0] * per) & (flat < LAYER[1] * per))
    normal = np.stack([flat[index + s] - flat[index - s] for s in strides], axis=1) * 0.5
    length = np.sqrt((normal**2).sum(axis=1))
    good = (length > GRADIENT[0]) & (length < GRADIENT[1])
    index, normal = index[good], normal[good]
    node = np.stack(np.unravel_index(index, field.shape), axis=1)
    main = np.abs(normal).argmax(axis=1)
    side = 2 * main + (normal[np.arange(len(main)), main] > 0)
    key = ((node // 2) @ strides) * 6 + side
    _, block, count = np.unique(key, return_inverse=True, return_counts=True)

    def mean(values: Float[np.ndarray, " nodes"]) -> Float64[np.ndarray, " planes"]:
        return np.bincount(block, values, len(count)) / count

    point = np.stack([mean(x) for x in node.T.astype(float)], axis=1)
    normal = np.stack([mean(x) for x in normal.T], axis=1)
    normal /= np.sqrt((normal**2).sum(axis=1, keepdims=True))
    return point, normal, mean(flat[index].astype(float))


def _averaged(
    point: Float64[np.ndarray, "planes 3"],
    normal: Float64[np.ndarray, "planes 3"],
    distance: Float64[np.ndarray, " planes"],
    a: Int[np.ndarray, " pairs"],
    b: Int[np.ndarray, " pairs"],
) -> tuple[Float64[np.ndarray, "planes 3"], Float64[np.ndarray, " planes"]]:
    """Normals and distances averaged over neighbours, less over those that face elsewhere."""
    weight = _similar(normal[a], normal[b])
    total = np.stack(
        [n + np.bincount(a, weight * n[b], len(n)) for n in np.ascontiguousarray(normal.T)], axis=1
    )
    mean = total / np.sqrt((total**2).sum(axis=1, keepdims=True))
    weight = _similar(mean[a], normal[b])
    own = _similar(mean, normal)
    seen = distance[b] + (mean[a] * (point[a] - point[b])).sum(axis=1)
    summed = own * distance + np.bincount(a, weight * seen, len(distance))
    return mean, summed / (own + np.bincount(a, weight, len(distance)))


def _similar(
    a: Float64[np.ndarray, "_ 3"], b: Float64[np.ndarray, "_ 3"]
) -> Float64[np.ndarray, " _"]:
    return np.exp(-((a - b) ** 2).sum(axis=1) / SIMILAR**2)
