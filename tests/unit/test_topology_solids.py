from typing import Any

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from skimage.measure import euler_number, label

from doughdata.topology.skeletons import Skeleton, cycle_rank, without_small_cycles
from doughdata.topology.solids import COVER, VOXEL, Closing, solid_genus

SPACING = 0.002


def cloud(seed: int) -> np.ndarray:
    """A lattice with holes and jitter."""
    rng = np.random.default_rng(seed)
    axis = np.arange(8) * SPACING
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    kept = grid[rng.random(len(grid)) < 0.5]
    return kept + rng.uniform(-0.3, 0.3, kept.shape) * SPACING


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("radius", [1.5, 1.75, 2.0])
def test_closing_matches_distance_transforms(seed: int, radius: float) -> None:
    """A solid holds the voxels that lie deep enough in the inflated particles."""
    closing = Closing(cloud(seed), SPACING, largest=2.0)
    depth: Any = distance_transform_edt(closing.distance < radius * SPACING)
    expected = depth * VOXEL > radius - COVER + 1e-9
    assert (closing.solid(radius).inside == expected).all()


@pytest.mark.parametrize("seed", range(4))
def test_genus_matches_another_euler_number(seed: int) -> None:
    """Handles are lumps plus voids minus the Euler number, here that of scikit-image."""
    inside = np.random.default_rng(seed).random((9, 8, 7)) < 0.6
    lumps: Any = label(inside, connectivity=3)
    outside: Any = label(np.pad(~inside, 1, constant_values=True), connectivity=1)
    expected = lumps.max() + outside.max() - 1 - euler_number(inside, connectivity=3)
    assert solid_genus(inside) == expected


def test_wall_parts_two_blocks() -> None:
    """Walls along the pairs between two touching blocks part the solid there and only there."""
    axis = np.arange(5) * SPACING
    block = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    x = np.concatenate([block, block + np.array([5 * SPACING, 0.0, 0.0])])
    near = np.argwhere(np.linalg.norm(x[:, None] - x[None], axis=2) < 2.5 * SPACING)
    walls = near[(near[:, 0] < len(block)) & (near[:, 1] >= len(block))]
    closing = Closing(x, SPACING, largest=2.0)
    whole = closing.solid(2.0)
    parted = closing.opened(whole, walls)
    lumps: list[Any] = [label(solid.inside, connectivity=3) for solid in (whole, parted)]
    assert [own.max() for own in lumps] == [1, 2]
    taken = closing.origin[0] + np.argwhere(whole.inside & ~parted.inside)[:, 0] * closing.size
    assert np.abs(taken - 4.5 * SPACING).max() < 2 * SPACING


def test_small_cycles_are_opened_first() -> None:
    """Of a large and a small loop the small one goes; the graph stays one part."""
    corners = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [5, 0, 0], [5, 1, 0]], float)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [1, 4], [4, 5], [5, 1]], np.int32)
    graph = Skeleton(positions=corners, edges=edges)
    assert cycle_rank(6, graph.edges) == 2
    one, clear = without_small_cycles(graph, 1)
    assert clear
    assert cycle_rank(6, one.edges) == 1
    assert {(0, 1), (1, 2), (2, 3), (3, 0)} <= {tuple(pair) for pair in one.edges.tolist()}
    for rank in (0, 1, 2, 3):
        left = without_small_cycles(graph, rank)[0].edges
        assert len(left) - 6 + 1 == cycle_rank(6, left) == min(rank, 2)


def test_loops_of_like_length_are_in_doubt() -> None:
    """Which of two equal loops is real nobody can say; that both are false is clear."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
    edges = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [3, 4], [4, 0]], np.int32)
    graph = Skeleton(positions=corners, edges=edges)
    assert [without_small_cycles(graph, rank)[1] for rank in (0, 1, 2)] == [True, False, True]
