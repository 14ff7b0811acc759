"""Distances on the lattice against scipy's transform, and the closing against closed forms."""

import numpy as np
from scipy import ndimage

from doughdata.mesh.distance import closing_field, nearest_node_distance


def test_distance_to_nodes_is_that_of_the_transform() -> None:
    """Up to the reach it equals scipy's Euclidean distance transform, at the border too."""
    rng = np.random.default_rng(5)
    shape = (17, 23, 14)
    nodes = np.stack([rng.integers(0, n, 30) for n in shape], axis=1)
    free = np.ones(shape, bool)
    free[tuple(nodes.T)] = False
    exact = ndimage.distance_transform_edt(free)
    for reach in (1.5, 3.0, 4.6):
        found = nearest_node_distance(nodes, shape, reach=reach)
        assert np.allclose(found, np.minimum(exact, reach), atol=1e-6)


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
