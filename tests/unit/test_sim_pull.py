"""The counterfactual pull: what holds together stays, what only touches comes apart."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from doughdata.sim.pull import MpmPullApart, PullConfig
from doughdata.stages import PullApart, PullProblem
from doughschemas import BadInputError

SPACING = 0.002
PULL = MpmPullApart(PullConfig(arch="cpu"))


def bar(*, neck: float = 1.0, gap: float = 0.0) -> np.ndarray:
    """A 40 x 16 x 16 mm bar, its middle thinned to half width `neck` [m] or cut by `gap` [m]."""
    axes = [np.arange(-h + SPACING / 2, h, SPACING) for h in (0.020, 0.008, 0.008)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    thick = np.abs(grid[:, 1:]).max(axis=1) < neck
    grid = grid[(np.abs(grid[:, 0]) > 0.002) | thick]
    grid = grid[np.abs(grid[:, 0]) > gap / 2]
    return grid + np.random.default_rng(0).uniform(-0.2, 0.2, grid.shape) * SPACING


def problem(positions: np.ndarray, *, direction=(1.0, 0.0, 0.0)) -> PullProblem:
    """Drive the ends beyond 10 mm apart by 4 mm each."""
    x = positions @ np.array(direction)
    middle = (x.min() + x.max()) / 2
    handles = np.where(x < middle - 0.010, 1, np.where(x > middle + 0.010, 2, 0))
    return PullProblem(
        positions=positions,
        handles=handles.astype(np.int8),
        direction=np.array(direction),
        distance=0.004,
        speed=0.25,
        spacing=SPACING,
    )


def count_pieces(positions: np.ndarray, *, radius: float = 1.8 * SPACING) -> int:
    """Clusters at a radius [m] that hold more than 2 % of the particles."""
    tree = cKDTree(positions)
    _, labels = connected_components(tree.sparse_distance_matrix(tree, radius))
    return int((np.bincount(labels) > 0.02 * len(positions)).sum())


def test_it_is_a_pull_apart() -> None:
    """The class obeys the protocol that the topology check is handed, and takes an empty list."""
    assert isinstance(MpmPullApart(), PullApart)
    assert PULL.pull_apart([]) == []


def test_separate_blocks_part_and_a_thick_neck_holds() -> None:
    """Two blocks 4 mm apart become two pieces, and a 12 mm neck stays one."""
    apart, thick = PULL.pull_apart([problem(bar(gap=0.004)), problem(bar(neck=0.006))])
    assert count_pieces(apart) == 2
    assert count_pieces(thick) == 1


def test_a_touch_is_not_a_bond() -> None:
    """A thread of one particle between two blocks tears."""
    assert count_pieces(PULL.pull_apart([problem(bar(neck=0.0012))])[0]) == 2


def test_handles_move_as_told() -> None:
    """Handle 2 travels the distance along the direction, handle 1 the same against it."""
    asked = problem(bar())
    moved = PULL.pull_apart([asked])[0] - asked.positions
    assert np.abs(moved[asked.handles == 2] - [0.004, 0, 0]).max() < 1e-6
    assert np.abs(moved[asked.handles == 1] + [0.004, 0, 0]).max() < 1e-6


def test_order_of_particles_does_not_matter() -> None:
    """The same crop in another order gives the same bytes."""
    asked = problem(bar(neck=0.004))
    order = np.random.default_rng(1).permutation(len(asked.positions))
    shuffled = PullProblem(
        positions=asked.positions[order],
        handles=asked.handles[order],
        direction=asked.direction,
        distance=asked.distance,
        speed=asked.speed,
        spacing=asked.spacing,
    )
    first, second = PULL.pull_apart([asked, shuffled])
    assert np.array_equal(first[order], second)


def test_place_and_yaw_do_not_matter() -> None:
    """A crop that is moved and turned about z is pulled to the moved and turned result."""
    c, s = np.cos(0.7), np.sin(0.7)
    turn, shift = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([0.04, -0.03, 0.02])
    asked = problem(bar(neck=0.004))
    moved = problem(asked.positions @ turn.T + shift, direction=tuple(turn @ asked.direction))
    assert np.array_equal(moved.handles, asked.handles)
    first, second = PULL.pull_apart([asked, moved])
    # Rounding of the input to single precision grows during the 120 substeps of a tear.
    assert np.abs(first @ turn.T + shift - second).max() < 0.02 * SPACING


def test_a_vertical_pull_works() -> None:
    """A pull along z, where the horizontal frame is undefined, gives what a pull along x gives."""
    turned = bar(gap=0.004)[:, [2, 1, 0]] * [-1, 1, 1]
    assert count_pieces(PULL.pull_apart([problem(turned, direction=(0.0, 0.0, 1.0))])[0]) == 2


def test_bad_problems_are_refused() -> None:
    """A direction that is no unit vector is an error in words."""
    with pytest.raises(BadInputError, match="unit vector"):
        PULL.pull_apart([problem(bar(), direction=(2.0, 0.0, 0.0))])
