"""Which key frames are read, and when a reading leaves a genus unsure."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from doughdata.topology.alpha import AlphaComplex
from doughdata.topology.dynamic import FILLED, DynamicConfig
from doughdata.topology.genus import read_shapes
from doughdata.topology.pairs import decode, near_keys
from doughdata.topology.readings import LoopWindow, has_no_loop, read_component
from doughdata.topology.runs import STRIDE, refine
from doughdata.topology.tracking import groups
from doughschemas import STRAY, FrameTopology, SceneGraph
from tests.topology_states import SPACING, lattice

WINDOW = LoopWindow(
    birth=DynamicConfig().loop_birth,
    death=FILLED + DynamicConfig().hole_radius,
    doubt=DynamicConfig().loop_doubt,
)


@given(
    changes=st.sets(st.integers(1, 74), max_size=5),
    also_likely=st.sets(st.integers(1, 74), max_size=5),
    finest=st.integers(1, 4),
)
def test_changes_are_found_between_readings(
    changes: set[int], also_likely: set[int], finest: int
) -> None:
    """Neighbouring readings agree and are near, or differ and are nearest or beside a hint."""
    likely = sorted(changes | also_likely)
    value = np.cumsum([k in changes for k in range(75)])
    seen = set()

    def read(frame: int) -> int:
        seen.add(frame)
        return int(value[frame])

    refine(
        0,
        74,
        read,
        lambda low, high: False,  # noqa: ARG005 - of the protocol
        lambda low, high: [k for k in likely if low < k <= high],
        finest=finest,
    )
    assert {0, 74} <= seen
    frames = sorted(seen)
    for low, high in itertools.pairwise(frames):
        agree = value[low] == value[high]
        assert high - low <= (STRIDE if agree else finest)


def test_a_known_change_needs_few_readings() -> None:
    """One change at a hint among 75 settled key frames: both ends and both sides of it are read."""
    seen = set()

    def read(frame: int) -> bool:
        seen.add(frame)
        return frame >= 52

    refine(0, 74, read, lambda low, high: True, lambda low, high: [52])  # noqa: ARG005
    assert seen == {0, 51, 52, 74}


def doubtful_plate() -> np.ndarray:
    """A plate with a hole of four particles that only the window for smaller holes sees."""
    low, high = (-0.012, -0.012, 0), (0.012, 0.012, 0.008)
    return lattice(low, high, lambda g: np.hypot(g[:, 0], g[:, 1]) > 0.0025)


@pytest.mark.parametrize(("merge", "sure"), [(None, True), (1, True), (6, False), (9, False)])
def test_a_small_hole_is_a_doubt_only_after_a_merge(merge: int | None, sure: bool) -> None:
    """A hole near the smallest size is unsure where a merge can have made it, else it is a pore.

    It is there from key frame 8 on; a merge long before has left no handle, as key frame 7 shows.
    """
    wide = doubtful_plate()
    x = np.stack([wide * (0.9, 0.9, 1.0)] * 8 + [wide] * 4).astype(np.float32)
    bonds = [decode(near_keys(own.astype(float), 2 * SPACING), len(wide)) for own in x]
    apart = np.zeros((0, 2), np.int64)
    readings = [
        read_component(x[k].astype(float), bonds[k], apart, SPACING, WINDOW) for k in (7, 8)
    ]
    assert [(r.floor, r.genus, r.ceiling) for r in readings] == [(0, 0, 0), (0, 0, 1)]
    shapes = read_shapes(
        x,
        [np.zeros(len(wide), np.uint8)] * 12,
        bonds,
        [apart] * 12,
        loops=[int(k == merge) for k in range(12)],
        changed=[k == merge for k in range(12)],
        crossed=[False] * 12,
        spacing=SPACING,
        window=WINDOW,
    )
    assert [own[0].genus for own in shapes] == [0] * 12
    assert shapes[0][0].sure
    assert [own[0].sure for own in shapes[8:]] == [sure] * 4


def genera(bodies: list[np.ndarray], *, merges: int = 0, at: int = 8) -> list[int]:
    """Genus of one body in every key frame, with so many merges within it in one of them."""
    x = np.stack(bodies).astype(np.float32)
    frames, (count, _) = len(x), bodies[0].shape
    shapes = read_shapes(
        x,
        [np.zeros(count, np.uint8)] * frames,
        [decode(near_keys(own.astype(float), 2 * SPACING), count) for own in x],
        [np.zeros((0, 2), np.int64)] * frames,
        loops=[merges * (k == at) for k in range(frames)],
        changed=[merges > 0 and k == at for k in range(frames)],
        crossed=[False] * frames,
        spacing=SPACING,
        window=WINDOW,
    )
    assert [len(own) for own in shapes] == [1] * frames
    for (shape,) in shapes:
        assert len(shape.skeleton.edges) - len(shape.nodes) + 1 == shape.genus
    return [shape.genus for (shape,) in shapes]


def test_a_hole_that_shrinks_is_gone_at_the_smallest_size_that_counts() -> None:
    """Nothing was merged: the last readings have no hole, but are not sure of it."""
    small = doubtful_plate()
    assert genera([small * (1.5, 1.5, 1.0)] * 6 + [small] * 6) == [1] * 6 + [0] * 6


def plate_with_three_holes() -> np.ndarray:
    """Of 8 mm each, in a row."""

    def inside(g: np.ndarray) -> np.ndarray:
        rows = [np.hypot(g[:, 0] - middle, g[:, 1]) for middle in (-0.018, 0.0, 0.018)]
        return np.min(rows, axis=0) > 0.004

    return lattice((-0.028, -0.010, 0), (0.028, 0.010, 0.006), inside)


@pytest.mark.parametrize("merges", range(5))
def test_there_are_no_more_new_handles_than_merges(merges: int) -> None:
    """Three holes open at once; what no merge within the piece explains is none."""
    open_ = plate_with_three_holes()
    closed = open_ * (0.5, 0.5, 1.0)
    assert genera([closed] * 8 + [open_] * 8, merges=merges) == [0] * 8 + [min(merges, 3)] * 8


def test_a_handle_lasts_while_more_are_read_than_merges_explain() -> None:
    """One merge, one hole for three key frames, which is no time, then three."""
    three = plate_with_three_holes()
    closed = three * (0.5, 0.5, 1.0)
    one = three.copy()
    one[:, 1] *= np.where(np.abs(three[:, 0]) < 0.009, 1.0, 0.3)
    assert genera([closed] * 8 + [one] * 3 + [three] * 6, merges=1) == [0] * 8 + [1] * 9


def frame_of(labels: np.ndarray) -> FrameTopology:
    number = int(labels[labels != STRAY].max()) + 1
    return FrameTopology(
        labels=labels,
        genus=(0,) * number,
        graph=SceneGraph(
            positions=np.zeros((number, 3), np.float32),
            components=np.arange(number, dtype=np.uint8),
            particles=np.bincount(labels[labels != STRAY]).astype(np.int32),
            edges=np.zeros((0, 2), np.int32),
        ),
        contacts=np.zeros((0, 2), np.int32),
    )


def test_what_stays_is_related_to_itself_alone() -> None:
    """Equal labels and labels that differ by one stray particle give the same groups."""
    labels = np.repeat(np.arange(3, dtype=np.uint8), [30, 40, 50])
    stray = labels.copy()
    stray[0] = STRAY
    assert groups(frame_of(labels), frame_of(labels)) == [([k], [k]) for k in range(3)]
    assert groups(frame_of(stray), frame_of(labels)) == [([k], [k]) for k in range(3)]


def holed_plate(seed: int) -> np.ndarray:
    """A thin plate that was drilled through, 2 to 9 mm wide, at up to two places."""
    rng = np.random.default_rng(seed)
    number = rng.integers(0, 3)
    middle, radius = rng.uniform(-0.014, 0.014, (number, 2)), rng.uniform(0.001, 0.0045, number)

    def inside(g: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(g[:, None, :2] - middle, axis=2)
        return (away > radius).all(axis=1)

    return lattice((-0.02, -0.02, 0), (0.02, 0.02, 0.006), inside, seed=seed)


def test_what_is_read_without_a_tetrahedralisation_has_no_loop() -> None:
    """A body read as filled, without its alpha complex, has no loop in the alpha complex either."""
    filled = 0
    for seed in range(40):
        x = holed_plate(seed)
        lasting = AlphaComplex.of(x / SPACING).lasting(WINDOW.nested, without=np.zeros(0, np.int64))
        if has_no_loop(x, SPACING, WINDOW):
            filled += 1
            assert lasting == [0, 0, 0]
    assert 5 < filled < 35
