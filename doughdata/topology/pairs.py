"""Sets of particle pairs as sorted integer keys, and what is connected by them.

A pair (i, j) with i < j among n particles has the key i * n + j, so that a set of pairs is a sorted
int64 array and set operations are merges of sorted arrays.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
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
    "without",
]


def encode(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> Int64[np.ndarray, " pairs"]:
    """Sorted keys of pairs of `count` particles."""
    pairs = np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1)
    return np.sort(pairs[:, 0] * count + pairs[:, 1])


def decode(keys: Int64[np.ndarray, " pairs"], count: int) -> Int64[np.ndarray, "pairs 2"]:
    """Pairs of sorted keys, lower particle first."""
    return np.stack([keys // count, keys % count], axis=1)


def near_keys(
    positions: Float64[np.ndarray, "particles 3"], radius: float
) -> Int64[np.ndarray, " pairs"]:
    """Keys of all pairs closer than `radius` [m]."""
    pairs = KDTree(positions).query_pairs(radius, output_type="ndarray")
    return encode(pairs, len(positions))


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


def lengths(
    positions: Float64[np.ndarray, "particles 3"], pairs: Int64[np.ndarray, "pairs 2"]
) -> Float64[np.ndarray, " pairs"]:
    """Distance [m] between the ends of each pair."""
    step = positions[pairs[:, 0]] - positions[pairs[:, 1]]
    return np.sqrt(np.einsum("ij,ij->i", step, step))


def adjacency(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> csr_matrix:
    """Symmetric 0/1 matrix of a set of pairs."""
    rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
    columns = np.concatenate([pairs[:, 1], pairs[:, 0]])
    return csr_matrix((np.ones(len(rows), np.float32), (rows, columns)), (count, count))


def connected(pairs: Int64[np.ndarray, "pairs 2"], count: int) -> Int32[np.ndarray, " particles"]:
    """Piece of each particle when pairs hold together; a lone particle is a piece of its own."""
    if len(pairs) == 0:
        return np.arange(count, dtype=np.int32)
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (count, count))
    return connected_components(graph, directed=False)[1]
