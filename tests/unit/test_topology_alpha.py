"""Lasting loops, against closed forms, dense algebra and an independent library."""

import gudhi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from doughdata.topology.alpha import AlphaComplex, sparse_rank
from doughdata.topology.pairs import encode
from tests.topology_states import SPACING, bar, lattice, ring

WINDOWS = [(0.9, 1.65), (1.0, 1.55), (1.1, 1.45)]
NONE = np.zeros(0, np.int64)
FLAT = np.c_[np.random.default_rng(0).uniform(0.0, 5.0, (30, 2)), np.ones(30)]


def bars(points: np.ndarray, without: np.ndarray) -> np.ndarray:
    """Births and deaths of loops by gudhi's alpha complex, without some edges."""
    tree = gudhi.AlphaComplex(points=points).create_simplex_tree()
    for pair in without.tolist():
        if tree.find(pair):
            tree.assign_filtration(pair, np.inf)
    if len(without):
        tree.make_filtration_non_decreasing()
    tree.compute_persistence(homology_coeff_field=2)
    return np.sqrt(tree.persistence_intervals_in_dimension(1).reshape(-1, 2))


def alive(found: np.ndarray, birth: float, death: float) -> int:
    return int(((found[:, 0] <= birth) & (found[:, 1] > death)).sum())


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(5, 300), cut=st.integers(0, 60))
def test_loops_are_those_of_another_library(seed: int, count: int, cut: int) -> None:
    """In random clouds, with random edges left out, every window holds the bars that span it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, count ** (1 / 3), (count, 3))
    made = AlphaComplex.of(points)
    pairs = made.ends[rng.integers(0, len(made.ends), cut)]
    windows = [(0.5, 0.95), (0.6, 0.75), (0.65, 0.7)]
    found = bars(points, pairs)
    expected = [alive(found, *window) for window in windows]
    assert made.lasting(windows, without=encode(pairs, count)) == expected


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 30), columns=st.integers(0, 60))
def test_rank_is_that_of_dense_elimination(seed: int, rows: int, columns: int) -> None:
    """The rank over two elements is the number of pivots of plain elimination."""
    rng = np.random.default_rng(seed)
    ones = [rng.permutation(rows)[: rng.integers(0, min(3, rows) + 1)] for _ in range(columns)]
    sparse = np.full((columns, 3), -1)
    left = []
    for own, listed in zip(ones, sparse, strict=True):
        listed[: len(own)] = own
        left.append(sum(1 << int(row) for row in own))
    pivots = 0
    while left:
        if (column := left.pop()) != 0:
            pivots += 1
            top = 1 << (column.bit_length() - 1)
            left = [other ^ column if other & top else other for other in left]
    assert sparse_rank(sparse) == pivots


@pytest.mark.parametrize(("solid", "loops"), [(bar(), 0), (ring(), 1)])
def test_solids_have_their_loops(solid: np.ndarray, loops: int) -> None:
    """A bar of particles has no loop and a ring one, turned and moved anywhere."""
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    for points in (solid, solid @ turn.T + [0.05, -0.02, 0.01]):
        made = AlphaComplex.of(points / SPACING)
        assert made.lasting(WINDOWS, without=NONE) == [loops] * 3


@pytest.mark.parametrize(("width", "loops"), [(2.0, 0), (3.0, 0), (3.7, 1), (5.0, 1)])
def test_a_hole_counts_from_a_size_on(width: float, loops: int) -> None:
    """A round hole is one if a ball of 1.55 spacings passes between its particles."""
    block = lattice((-0.012, -0.012, 0.0), (0.012, 0.012, 0.006)) / SPACING
    away = np.hypot(block[:, 0], block[:, 1])
    plate = block[away > width / 2]
    rim = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    rims = [width / 2 * np.c_[np.cos(rim), np.sin(rim), np.full(24, 2 * z / width)]
            for z in (0.5, 1.5, 2.5)]  # fmt: skip
    made = AlphaComplex.of(np.concatenate([plate, *rims]))
    (found,) = made.lasting([(1.0, 1.55)], without=NONE)
    assert found == loops


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.eye(3), np.arange(21.0).reshape(7, 3), FLAT]
)
def test_too_little_for_a_solid_has_no_loop(points: np.ndarray) -> None:
    """No particles, fewer than a tetrahedron needs, all on a line or in a plane: no loop."""
    assert AlphaComplex.of(points).lasting(WINDOWS, without=NONE) == [0, 0, 0]
