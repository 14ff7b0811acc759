"""The repaired node set: well-composed, apart, in one piece, without hollows."""

import numpy as np
import pytest
import skimage.measure
from scipy import ndimage

from doughdata.mesh.lumps import bridge_lumps, drop_lumps, fill_cavities, find_lumps, seed_missing
from doughdata.mesh.repair import make_well_composed, separate, well_composed_genus
from doughschemas import NO_COMPONENT

EVERY = np.ones((3, 3, 3), bool)


def noise(seed: int, *, components: int, smooth: float) -> tuple[np.ndarray, np.ndarray]:
    """Random field and labels with an empty border of four nodes."""
    rng = np.random.default_rng(seed)
    fields = []
    for _ in range(components):
        field = ndimage.gaussian_filter(rng.normal(size=(20, 18, 16)), smooth)
        fields.append(np.pad(field / field.std() + 0.3, 4, constant_values=3.0))
    best = np.argmin(fields, axis=0)
    field = np.min(fields, axis=0).astype(np.float32)
    labels = np.where(field < 0, best, NO_COMPONENT).astype(np.uint8)
    return field, labels


def cell_views(values: np.ndarray) -> np.ndarray:
    """The eight corners of every cell, (cells, 2, 2, 2)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, (2, 2, 2))
    return windows.reshape(-1, 2, 2, 2)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("smooth", [0.0, 0.7, 1.5])
def test_repaired_set_is_well_composed(seed: int, smooth: float) -> None:
    """In every cell the inside nodes are one edge-connected set, and so are the outside ones."""
    field, labels = noise(seed, components=1, smooth=smooth)
    make_well_composed(field, labels)
    inside = labels != NO_COMPONENT
    assert inside.any()
    for cell in np.unique(cell_views(inside), axis=0):
        assert ndimage.label(cell)[1] <= 1
        assert ndimage.label(~cell)[1] <= 1


@pytest.mark.parametrize("seed", range(6))
def test_repair_keeps_field_and_labels_together(seed: int) -> None:
    """The repaired field is negative just at labelled nodes; no cell holds two labels."""
    field, labels = noise(seed, components=3, smooth=0.7)
    separate(field, labels)
    make_well_composed(field, labels)
    assert np.array_equal(field < 0, labels != NO_COMPONENT)
    for cell in cell_views(labels):
        assert len(np.unique(cell[cell != NO_COMPONENT])) <= 1


def blocks(*corners: tuple[int, int, int], size: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Cubes of nodes, one component."""
    labels = np.full((40, 20, 20), NO_COMPONENT, np.uint8)
    for i, j, k in corners:
        labels[i : i + size, j : j + size, k : k + size] = 0
    return np.where(labels == 0, -1.0, 1.0).astype(np.float32), labels


def test_small_lumps_go_and_large_ones_stay() -> None:
    """A lump below the share of the largest is dropped, one above it stays."""
    field, labels = blocks((5, 5, 5), (20, 5, 5))
    labels[30, 10, 10], field[30, 10, 10] = 0, -1.0
    drop_lumps(field, labels, find_lumps(labels, share=0.02))
    assert ndimage.label(labels == 0)[1] == 2
    assert field[30, 10, 10] > 0


def test_lumps_within_reach_are_bridged() -> None:
    """Two lumps of one label become one when a bar within reach joins them, else stay two."""
    field, labels = blocks((5, 5, 5), (13, 7, 5), (28, 5, 5))
    assert bridge_lumps(field, labels, find_lumps(labels, share=0.02), reach=6.0)
    make_well_composed(field, labels)
    assert ndimage.label(labels == 0)[1] == 2
    assert not bridge_lumps(field, labels, find_lumps(labels, share=0.02), reach=6.0)


def test_hollow_is_filled() -> None:
    """A hollow inside one component becomes part of it; the exterior does not."""
    field, labels = blocks((5, 5, 5), size=8)
    labels[7:9, 7:9, 7:9], field[7:9, 7:9, 7:9] = NO_COMPONENT, 1.0
    fill_cavities(field, labels)
    assert (labels == 0).sum() == 8**3
    assert np.array_equal(field < 0, labels == 0)


def test_lost_component_gets_a_node() -> None:
    """A component without nodes gets one that touches no other component."""
    field, labels = blocks((5, 5, 5))
    seed_missing(field, labels, [np.full((3, 3), 6.0), np.full((3, 3), 7.0)])
    assert (labels == 1).sum() == 1
    near = ndimage.binary_dilation(labels == 1, EVERY)
    assert not (labels[near] == 0).any()


@pytest.mark.parametrize("seed", range(6))
def test_genus_of_set_is_that_of_voxels(seed: int) -> None:
    """The genus of a well-composed set is b1 = b0 + b2 - Euler characteristic of its voxels."""
    field, labels = noise(seed, components=1, smooth=0.8)
    make_well_composed(field, labels)
    inside = labels == 0
    hollows = ndimage.label(~inside)[1] - 1
    euler = skimage.measure.euler_number(inside, connectivity=3)
    assert well_composed_genus(inside) == ndimage.label(inside, EVERY)[1] + hollows - euler
