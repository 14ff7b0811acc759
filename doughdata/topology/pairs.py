"""Sets of particle pairs as sorted integer keys, and what is connected by them.

A pair (i, j) with i < j among n particles has the key i * n + j, so that a set of pairs is a sorted
int64 array and set operations are merges of sorted arrays.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int, Int32, Int64
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

__all__ = [
    "adjacency",
    "connected",
    "decode",
    "encode",
    "is_member",
    "lengths",
    "near_keys",
    "rows_of",
    "without",
]


def encode(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> Int64[np.ndarray, " pairs"]:
    """Sorted keys of pairs of `count` particles."""
    pairs = np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1)
    return np.sort(pairs[:, 0] * count + pairs[:, 1])


def decode(keys: Int64[np.ndarray, " pairs"], count: int) -> Int64[np.ndarray, "pairs 2"]:
    """Pairs of sorted keys, lower particle first."""
    pairs = np.empty((len(keys), 2), np.int64)
    np.floor_divide(keys, count, out=pairs[:, 0])
    np.subtract(keys, pairs[:, 0] * count, out=pairs[:, 1])
    return pairs


def near_keys(
    positions: Float64[np.ndarray, "particles 3"], radius: float
) -> Int64[np.ndarray, " pairs"]:
    """Keys of all pairs closer than `radius` [m]."""
    # Plain trees with large leaves are searched fastest: particles lie evenly.
    tree = KDTree(positions, leafsize=24, balanced_tree=False, compact_nodes=False)
    pairs = tree.query_pairs(radius, output_type="ndarray")  # lower particle first
    keys = pairs[:, 0] * len(positions) + pairs[:, 1]
    keys.sort()
    return keys


def is_member(
    keys: Int64[np.ndarray, " pairs"], table: Int64[np.ndarray, " known"]
) -> Bool[np.ndarray, " pairs"]:
    """Which keys occur in a sorted table."""
    if len(table) == 0 or len(keys) == 0:
        return np.zeros(len(keys), dtype=bool)
    place = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    return table[place] == keys


def without(
    keys: Int64[np.ndarray, " pairs"], table: Int64[np.ndarray, " known"]
) -> Int64[np.ndarray, " _"]:
    """Keys that are not in a sorted table."""
    return keys[~is_member(keys, table)]


def rows_of(
    keys: Int64[np.ndarray, " pairs"], table: Int64[np.ndarray, " known"]
) -> Int64[np.ndarray, " _"]:
    """Rows of a sorted table that hold any of the keys; keys that it lacks are passed over."""
    if len(table) == 0 or len(keys) == 0:
        return np.zeros(0, np.int64)
    place = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    return place[table[place] == keys]


def lengths(
    positions: Float64[np.ndarray, "particles 3"], pairs: Int64[np.ndarray, "pairs 2"]
) -> Float64[np.ndarray, " pairs"]:
    """Distance [m] between the ends of each pair."""
    first, second = pairs[:, 0], pairs[:, 1]
    square = np.zeros(len(pairs))
    for axis in np.ascontiguousarray(positions.T):  # three times faster than rows of three
        step = axis.take(first)
        step -= axis.take(second)
        step *= step
        square += step
    return np.sqrt(square, out=square)


def adjacency(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> csr_matrix:
    """Symmetric 0/1 matrix of a set of pairs."""
    rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
    columns = np.concatenate([pairs[:, 1], pairs[:, 0]])
    return csr_matrix((np.ones(len(rows), np.float32), (rows, columns)), (count, count))


def connected(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> Int32[np.ndarray, " particles"]:
    """Piece of each particle when pairs hold together; a lone particle is a piece of its own.

    Pieces are numbered by their lowest particle.
    """
    if len(pairs) == 0:
        return np.arange(count, dtype=np.int32)
    if len(pairs) < 8 * count:
        return _connected(pairs, count)
    # Few of many pairs join almost everything; the others are only asked where they still can.
    piece = _connected(pairs[:: len(pairs) // (4 * count)], count)
    first, second = piece.take(pairs[:, 0]), piece.take(pairs[:, 1])
    left = np.flatnonzero(first != second)
    if len(left) == 0:
        return piece
    ends = np.stack([first[left], second[left]], axis=1)
    return _connected(ends, int(piece.max()) + 1)[piece]


def _connected(pairs: Int[np.ndarray, "pairs 2"], count: int) -> Int32[np.ndarray, " particles"]:
    first = pairs[:, 0]
    ones = np.ones(len(pairs), np.float64)  # what the search wants; anything else is copied
    graph: csr_matrix | coo_matrix
    if (first[1:] >= first[:-1]).all():  # rows in order, as sorted keys have them
        starts = np.zeros(count + 1, np.int32)
        np.cumsum(np.bincount(first, minlength=count), out=starts[1:])
        graph = csr_matrix((ones, pairs[:, 1].astype(np.int32), starts), (count, count))
    else:
        graph = coo_matrix((ones, (first, pairs[:, 1])), (count, count))
    return connected_components(graph, directed=False)[1]
