"""Scene-topology graphs: a solid thinned to curves, the curves cut into a simple graph."""

import itertools
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.ndimage import binary_fill_holes
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial import KDTree
from skimage.measure import label
from skimage.morphology import skeletonize

from doughdata.topology.pairs import connected
from doughdata.topology.solids import Solid

__all__ = ["Skeleton", "cycle_rank", "skeleton_of", "without_small_cycles"]

NODE_LENGTH = 0.008  # [m], between nodes of a graph
SPUR = 0.008  # [m], branches that end sooner are no branches
SMALL = 0.6  # of the shortest loop that is kept, below which a loop may be opened without a doubt
NEIGHBOUR = 1.8  # [voxels]; over sqrt(3), below 2: the 26 neighbours


@dataclass(frozen=True, slots=True, kw_only=True)
class Skeleton:
    """Simple graph of one component: no self-loops, no double edges."""

    positions: Float64[np.ndarray, "nodes 3"]  # [m], world
    edges: Int32[np.ndarray, "edges 2"]


@dataclass(frozen=True, slots=True)
class _Arc:
    """A curve between two nodes (equal for a loop); points run from `start` to `end`."""

    start: int
    end: int
    points: Float64[np.ndarray, "points 3"]  # [voxels]

    @property
    def length(self) -> float:
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def reversed(self) -> "_Arc":
        return _Arc(self.end, self.start, self.points[::-1])


def cycle_rank(nodes: int, edges: Int32[np.ndarray, "edges 2"]) -> int:
    """Number of independent cycles of a graph: edges - nodes + parts."""
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (nodes, nodes))
    return len(edges) - nodes + int(connected_components(graph, directed=False)[0])


def skeleton_of(solid: Solid, *, length: float = NODE_LENGTH, spur: float = SPUR) -> Skeleton:
    """Thin a solid to a graph with a node about every `length` [m].

    Branches that end within `spur` [m] are dropped. Thinning (Lee, Kashyap and Chu 1994, in
    scikit-image) keeps handles; voids are filled first. Only the largest lump is kept.
    """
    filled = np.asarray(binary_fill_holes(solid.inside))
    lumps: Any = label(filled, connectivity=3)
    if lumps.max() > 1:
        filled = lumps == 1 + int(np.argmax(np.bincount(lumps.ravel())[1:]))
    thin = np.argwhere(skeletonize(filled))
    if len(thin) == 0:
        thin = np.argwhere(filled)[:1]
    nodes, arcs = _trace(thin)
    arcs = _prune(arcs, spur / solid.size)
    points, edges = _simple(nodes, arcs, length / solid.size)
    return Skeleton(positions=solid.origin + points * solid.size, edges=edges)


def without_small_cycles(skeleton: Skeleton, rank: int) -> tuple[Skeleton, bool]:
    """The same graph with at most `rank` cycles: those that close the shortest loops are opened.

    Also whether it is clear which: none that was opened is nearly as long as one that was kept.
    """
    edges, nodes = skeleton.edges, len(skeleton.positions)
    extra = cycle_rank(nodes, edges) - rank
    if extra <= 0:
        return skeleton, True
    length = np.linalg.norm(np.diff(skeleton.positions[edges], axis=1)[:, 0], axis=1)
    graph = coo_matrix((length, (edges[:, 0], edges[:, 1])), (nodes, nodes))
    tree = minimum_spanning_tree(graph).tocoo()
    kept = {frozenset(pair) for pair in zip(tree.row.tolist(), tree.col.tolist(), strict=True)}
    closing = [k for k, pair in enumerate(edges.tolist()) if frozenset(pair) not in kept]
    way = dijkstra(tree, directed=False, indices=edges[closing, 0])
    loop = length[closing] + way[np.arange(len(closing)), edges[closing, 1]]
    order = np.argsort(loop, kind="stable")
    clear = rank <= 0 or bool(loop[order[extra - 1]] < SMALL * loop[order[extra]])
    opened = np.asarray(closing)[order[:extra]]
    return Skeleton(positions=skeleton.positions, edges=np.delete(edges, opened, axis=0)), clear


def _trace(
    thin: Int64[np.ndarray, "voxels 3"],
) -> tuple[Float64[np.ndarray, "nodes 3"], list[_Arc]]:
    """Nodes (clusters of branching voxels, ends, one on each bare loop) and the arcs between."""
    count = len(thin)
    pairs = KDTree(thin).query_pairs(NEIGHBOUR, output_type="ndarray")
    degree = np.bincount(pairs.ravel(), minlength=count)
    branch, end = degree >= 3, degree <= 1
    both = branch[pairs].all(axis=1)
    cluster = connected(pairs[both], count)
    is_node = branch | end | _loop_seeds(pairs, degree)
    _, place = np.unique(cluster[is_node], return_inverse=True)
    node = np.full(count, -1)
    node[is_node] = place
    totals = np.zeros((place.max() + 1, 3))
    np.add.at(totals, place, thin[is_node].astype(float))
    centres = totals / np.bincount(place)[:, None]
    return centres, _walk(thin, pairs, node, centres)


def _loop_seeds(
    pairs: Int64[np.ndarray, "pairs 2"], degree: Int64[np.ndarray, " voxels"]
) -> Bool[np.ndarray, " voxels"]:
    """One voxel of every part that has neither branch nor end."""
    part = connected(pairs, len(degree))
    plain = np.bincount(part, weights=degree != 2) == 0
    seed = np.zeros(len(degree), dtype=bool)
    first = np.unique(part, return_index=True)[1]
    seed[first[plain]] = True
    return seed


def _walk(
    thin: Int64[np.ndarray, "voxels 3"],
    pairs: Int64[np.ndarray, "pairs 2"],
    node: Int64[np.ndarray, " voxels"],
    centres: Float64[np.ndarray, "nodes 3"],
) -> list[_Arc]:
    """Follow every chain of plain voxels from node to node, once."""
    near: list[list[int]] = [[] for _ in range(len(thin))]
    for a, b in pairs.tolist():
        if node[a] < 0 or node[b] < 0 or node[a] != node[b]:
            near[a].append(b)
            near[b].append(a)
    arcs, seen = [], np.zeros(len(thin), dtype=bool)
    for start in np.flatnonzero(node >= 0).tolist():
        for follow in sorted(near[start]):
            if seen[follow] or (node[follow] >= 0 and follow < start):
                continue
            chain, now = [], follow
            while node[now] < 0:
                seen[now] = True
                before = chain[-1] if chain else start
                chain.append(now)
                onward = [v for v in near[now] if v != before and not (node[v] < 0 and seen[v])]
                now = onward[0] if onward else start
            a, b = int(node[start]), int(node[now])
            if a == b and len(chain) < 4:
                continue  # a corner of a branching cluster, no handle
            arcs.append(_Arc(a, b, np.vstack([centres[a], thin[chain], centres[b]])))
    return arcs


def _prune(arcs: list[_Arc], spur: float) -> list[_Arc]:
    """Drop short dead ends, shortest first, and join the arcs that meet in a plain node."""
    while True:
        arcs = _join(arcs)
        degree = Counter(node for arc in arcs for node in (arc.start, arc.end))
        dead = [
            arc
            for arc in arcs
            if min(degree[arc.start], degree[arc.end]) == 1
            and max(degree[arc.start], degree[arc.end]) > 2
            and arc.length < spur
        ]
        if not dead:
            return arcs
        worst = min(dead, key=lambda arc: (arc.length, arc.points.tolist()))
        arcs = [arc for arc in arcs if arc is not worst]


def _join(arcs: list[_Arc]) -> list[_Arc]:
    """Make one arc of two that meet where no third does."""
    while True:
        degree = Counter(node for arc in arcs for node in (arc.start, arc.end))
        loops = {arc.start for arc in arcs if arc.start == arc.end}
        plain = sorted(n for n, d in degree.items() if d == 2 and n not in loops)
        if not plain:
            return arcs
        first, second = (arc for arc in arcs if plain[0] in (arc.start, arc.end))
        if first.start == plain[0]:
            first = first.reversed()
        if second.end == plain[0]:
            second = second.reversed()
        joined = _Arc(first.start, second.end, np.vstack([first.points, second.points[1:]]))
        arcs = [arc for arc in arcs if plain[0] not in (arc.start, arc.end)]
        arcs.append(joined)


def _simple(
    nodes: Float64[np.ndarray, "nodes 3"], arcs: list[_Arc], length: float
) -> tuple[Float64[np.ndarray, "points 3"], Int32[np.ndarray, "edges 2"]]:
    """Cut arcs into edges of about `length`, so that no loop or double edge is left."""
    if not arcs:
        return nodes[:1], np.zeros((0, 2), np.int32)
    used = sorted({node for arc in arcs for node in (arc.start, arc.end)})
    place = {node: k for k, node in enumerate(used)}
    parallel = Counter(frozenset((arc.start, arc.end)) for arc in arcs)
    points = list(nodes[used])
    edges = []
    for arc in arcs:
        fewest = 3 if arc.start == arc.end else min(2, parallel[frozenset((arc.start, arc.end))])
        number = max(fewest, round(arc.length / length))
        inner = _along(arc.points, np.arange(1, number) / number)
        path = [place[arc.start], *range(len(points), len(points) + number - 1), place[arc.end]]
        points.extend(inner)
        edges += list(itertools.pairwise(path))
    return np.asarray(points), np.asarray(edges, dtype=np.int32).reshape(-1, 2)


def _along(
    points: Float64[np.ndarray, "points 3"], shares: Float64[np.ndarray, " shares"]
) -> Float64[np.ndarray, "shares 3"]:
    """Points at given shares of a polyline's length."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(step)]) / max(step.sum(), 1e-12)
    return np.stack([np.interp(shares, at, points[:, axis]) for axis in range(3)], axis=1)
