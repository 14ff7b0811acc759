"""The counterfactual question: would two sides stay together if they were pulled apart?

The answer is the number of vertex-disjoint particle paths left between the two driven ends after
the pull (Menger's theorem: the fewest particles whose removal parts them).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow
from scipy.spatial import KDTree

from doughdata.stages import PullApart, PullProblem
from doughschemas import BadInputError, Material

__all__ = ["PullTest", "disjoint_paths", "make_test", "most_paths", "run_tests"]

FEWEST_HANDLES = 15  # a side with fewer far particles uses its farthest 40 %


@dataclass(frozen=True, slots=True, kw_only=True)
class PullTest:
    """A patch with its two sides, ready to be pulled."""

    problem: PullProblem
    indices: Int64[np.ndarray, " crop"]  # of the crop's particles in the whole state
    first: Bool[np.ndarray, " crop"]  # driven end of side 1
    second: Bool[np.ndarray, " crop"]


def make_test(
    positions: Float64[np.ndarray, "particles 3"],
    *,
    first: Int64[np.ndarray, " first"],
    second: Int64[np.ndarray, " second"],
    core: Int64[np.ndarray, " core"],
    near: Int64[np.ndarray, " near"],
    direction: Float64[np.ndarray, " 3"],
    handle: float,
    distance: float,
    speed: float,
    spacing: float,
    material: Material,
) -> PullTest:
    """Set up a pull: the particles of both sides over `handle` [m] from `near` are driven.

    `core` moves freely with the sides. `second` moves along `direction`, `first` against it, by
    `distance` [m] at `speed` [m/s].
    """
    indices = np.union1d(np.union1d(first, second), core)
    far, _ = KDTree(positions[near]).query(positions[indices])
    driven = [_far_end(np.isin(indices, side), far, handle) for side in (first, second)]
    handles = (driven[0] + 2 * driven[1]).astype(np.int8)
    problem = PullProblem(
        positions=positions[indices],
        handles=handles,
        direction=direction / np.linalg.norm(direction),
        distance=distance,
        speed=speed,
        spacing=spacing,
        material=material,
    )
    return PullTest(problem=problem, indices=indices, first=driven[0], second=driven[1])


def _far_end(
    side: Bool[np.ndarray, " crop"], far: Float64[np.ndarray, " crop"], handle: float
) -> Bool[np.ndarray, " crop"]:
    end = side & (far > handle)
    if end.sum() >= FEWEST_HANDLES:
        return end
    return side & (far >= np.quantile(far[side], 0.6))


def run_tests(
    tests: Sequence[PullTest], puller: PullApart | None
) -> list[Float64[np.ndarray, "crop 3"]]:
    """Positions [m] after each pull.

    Raises:
        BadInputError: a pull is needed and nothing was handed in that can run it.
    """
    if not tests:
        return []
    if puller is None:
        raise BadInputError(
            "the dynamic check needs a simulator for its pull tests: "
            "hand one in, DynamicCheck(pull_apart=...)"
        )
    return puller.pull_apart([test.problem for test in tests])


def disjoint_paths(
    positions: Float64[np.ndarray, "crop 3"],
    first: Bool[np.ndarray, " crop"],
    second: Bool[np.ndarray, " crop"],
    radius: float,
) -> int:
    """Number of vertex-disjoint paths between two sets, steps shorter than `radius` [m]."""
    pairs = KDTree(positions).query_pairs(radius, output_type="ndarray")
    return most_paths(pairs, first, second)


def most_paths(
    pairs: Int64[np.ndarray, "pairs 2"],
    first: Bool[np.ndarray, " particles"],
    second: Bool[np.ndarray, " particles"],
) -> int:
    """Number of vertex-disjoint paths along pairs between two sets.

    Maximum flow with unit capacity through every particle that is in neither set.
    """
    count = len(first)
    source, sink = 2 * count, 2 * count + 1
    node = np.arange(count)
    enter = np.where(first, source, np.where(second, sink, node))
    leave = np.where(first, source, np.where(second, sink, node + count))
    free = np.flatnonzero(~first & ~second)
    start = np.concatenate([leave[pairs[:, 0]], leave[pairs[:, 1]], enter[free]])
    end = np.concatenate([enter[pairs[:, 1]], enter[pairs[:, 0]], leave[free]])
    useful = (start != end) & (end != source) & (start != sink)
    start, end = start[useful], end[useful]
    size = 2 * count + 2
    flow = csr_matrix((np.ones(len(start), np.int32), (start, end)), (size, size))
    flow.data[:] = 1  # parallel edges were summed; a particle carries one path anyway
    direct = int((first[pairs[:, 0]] & second[pairs[:, 1]]).sum())
    direct += int((second[pairs[:, 0]] & first[pairs[:, 1]]).sum())
    flow.data[_entry(flow, source, sink)] = max(direct, 1)
    return int(maximum_flow(flow, source, sink).flow_value)


def _entry(matrix: csr_matrix, row: int, column: int) -> Int64[np.ndarray, " _"]:
    """Place of one stored entry of a CSR matrix (empty when it is zero)."""
    low, high = matrix.indptr[row], matrix.indptr[row + 1]
    return low + np.flatnonzero(matrix.indices[low:high] == column)
