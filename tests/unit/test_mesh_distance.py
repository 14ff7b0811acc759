"""Distances and neighbours against scipy, and the closing against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from doughdata.mesh import compiled
from doughdata.mesh.compiled import nearest_points, spread_distance, spread_nearest
from doughdata.mesh.distance import closing_field


def scattered(seed: int, shape: tuple[int, int, int], count: int) -> np.ndarray:
    """Points in a lattice, at its border too."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (count, 3)) * (np.array(shape) - 1)


@pytest.mark.parametrize("reach", [0.4, 1.5, 3.0, 4.6, 9.2])
def test_spread_distances_are_those_of_a_tree(reach: float) -> None:
    """Up to the reach they are scipy's at every node, and the nearest point is the same."""
    shape = (17, 23, 14)
    points = scattered(5, shape, 30)
    nodes = np.stack(np.indices(shape), axis=-1).reshape(-1, 3)
    exact, index = (own.reshape(shape) for own in KDTree(points).query(nodes))
    distance, which = spread_nearest(points, shape, reach)
    assert np.allclose(distance, np.minimum(exact, reach), atol=1e-12)
    assert np.array_equal(which, np.where(exact < reach, index, -1))
    assert np.allclose(
        spread_distance(points, shape, reach), np.minimum(exact, reach), atol=1e-5 * max(reach, 1)
    )


def test_spread_from_no_point_reaches_nothing() -> None:
    """All nodes are beyond the reach."""
    none, shape = np.zeros((0, 3)), (3, 4, 5)
    distance, which = spread_nearest(none, shape, 2.0)
    assert np.array_equal(distance, np.full(shape, 2.0))
    assert np.array_equal(which, np.full(shape, -1))
    assert np.array_equal(spread_distance(none, shape, 2.0), np.full(shape, 2.0))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("at", [-0.6, 6.6])
def test_points_outside_are_refused(axis: int, at: float) -> None:
    """What would be written beside the lattice is an error."""
    point = np.full((1, 3), 3.0)
    point[0, axis] = at
    with pytest.raises(ValueError, match="outside of the lattice"):
        spread_distance(point, (7, 7, 7), 2.5)


def test_what_cannot_be_kept_is_compiled_again() -> None:
    """Code that belongs to no file has no folder for its machine code, and works all the same."""
    elsewhere = {"__name__": "elsewhere"}
    exec(compile(Path(compiled.__file__).read_text(), "<nowhere>", "exec"), elsewhere)
    points, shape = scattered(9, (9, 8, 7), 20), (9, 8, 7)
    found = elsewhere["spread_distance"](points, shape, 2.0)
    assert np.array_equal(found, spread_distance(points, shape, 2.0))


@pytest.mark.parametrize("cell", [0.3, 2.0, 50.0])
@pytest.mark.parametrize("flat", [0.0, 1.0])
def test_nearest_points_are_those_of_a_tree(cell: float, flat: float) -> None:
    """For queries among the points and far outside of them, in any order."""
    points = scattered(7, (20, 30, 12), 200) * (1, 1, flat)
    queries = scattered(8, (60, 60, 60), 150) - 20
    near = nearest_points(points, queries, 18, cell)
    exact, _ = KDTree(points).query(queries, k=18)
    distance = np.linalg.norm(points[near] - queries[:, None], axis=2)
    assert np.allclose(distance, exact, rtol=1e-12)
    assert all(len(set(own)) == 18 for own in near.tolist())


def test_closing_of_one_particle_is_the_particle() -> None:
    """Around a lone particle the field is the distance to it, within the sampling."""
    point = np.array([[12.3, 11.6, 12.1]])
    field = closing_field(point, (25, 24, 25), radius=2.4, level=0.8)
    nodes = np.stack(np.indices(field.shape), axis=-1)
    distance = np.linalg.norm(nodes - point[0], axis=-1)
    near = np.abs(distance - 0.8) < 0.4
    assert np.abs(field - distance)[near].max() < 0.35


def test_closing_does_not_know_the_border() -> None:
    """On a lattice that ends near the particles and on a larger one the values are the same."""
    rng = np.random.default_rng(6)
    for radius in (1.6, 2.4, 3.2):
        margin = int(np.ceil(radius)) + 2
        points = rng.uniform(margin, margin + 8, (150, 3))
        tight = closing_field(points, (2 * margin + 9,) * 3, radius=radius, level=0.8)
        wide = closing_field(points + 5, (2 * margin + 19,) * 3, radius=radius, level=0.8)
        inner = wide[5:-5, 5:-5, 5:-5]
        close = np.abs(inner - 0.8) < 1.5
        assert np.array_equal(tight < 0.8, inner < 0.8)
        assert np.allclose(tight[close], inner[close], atol=1e-5)
