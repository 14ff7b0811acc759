"""Repair of a labelled node set, so that its contour is a manifold by construction.

A set of nodes is well-composed (Latecki, Eckhardt and Rosenfeld 1995) when no 2x2 face is a
checkerboard and no cell holds two opposite corners alone. Then the nodes inside and the nodes
outside are each connected within every cell, the contour crosses a cell in one disc, and one
vertex a cell makes an edge- and vertex-manifold surface.
"""

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8

from doughdata.registry import require_package
from doughschemas import NO_COMPONENT

__all__ = ["CORNERS", "cell_codes", "make_well_composed", "separate", "well_composed_genus"]

# Corner c of a cell is at its low node + CORNERS[c]; bit c of a cell code is that corner's state.
CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
NEAR_ZERO = 0.05  # [cells], value given to a node that changes sides
FREE_ROUNDS = 6  # rounds of repair that may add nodes; later ones only remove, so that they end


def _critical_table() -> Bool[np.ndarray, "256 8"]:
    """For every cell code the corners that take part in a critical configuration."""
    inside = (np.arange(256)[:, None] >> np.arange(8)) & 1 == 1
    members = np.zeros((256, 8), bool)
    faces = [np.flatnonzero(CORNERS[:, axis] == side) for axis in range(3) for side in (0, 1)]
    for face in faces:  # corners in the order 00, 01, 10, 11
        a, b, c, d = inside[:, face].T
        crossed = (a == d) & (b == c) & (a != b)
        members[np.ix_(crossed, face)] = True
    for corner in range(4):
        pair = inside[:, [corner, 7 - corner]]
        count = inside.sum(axis=1)
        alone = (pair.all(axis=1) & (count == 2)) | (~pair.any(axis=1) & (count == 6))
        members[alone] = True
    return members


CRITICAL = _critical_table()
CRITICAL_CODES = np.any(CRITICAL, axis=1)
BITS = 1 << np.arange(8)


def cell_codes(inside: Bool[np.ndarray, "nx ny nz"]) -> UInt8[np.ndarray, "cx cy cz"]:
    """Corner states of every cell as eight bits."""
    codes = inside.view(np.uint8)
    for axis, width in ((2, 1), (1, 2), (0, 4)):  # corners along z, then of faces, then of cells
        rows = np.moveaxis(codes, axis, 0)
        codes = np.moveaxis(rows[:-1] | rows[1:] << np.uint8(width), 0, axis)
    return codes


def separate(field: Float32[np.ndarray, "nx ny nz"], labels: UInt8[np.ndarray, "nx ny nz"]) -> None:
    """Drop nodes, in place, until no cell holds inside nodes of two labels.

    Of two nodes of different labels in one cell the shallower goes. One pass over the thirteen
    directions is enough: dropping a node makes no new conflict.
    """
    owners = labels[labels != NO_COMPONENT]
    if not len(owners) or owners.min() == owners.max():
        return
    for offset in CORNERS[1:]:
        for signs in _mirrors(offset):
            low, high = _pair_views(labels.shape, offset * signs)
            a, b = labels[low], labels[high]
            clash = (a != b) & (a != NO_COMPONENT) & (b != NO_COMPONENT)
            if not bool(np.any(clash)):
                continue
            first = clash & (field[low] >= field[high])
            for view, drop in ((low, first), (high, clash & ~first)):
                labels[view][drop] = NO_COMPONENT
                field[view][drop] = NEAR_ZERO


def _mirrors(offset: Int[np.ndarray, " 3"]) -> list[Int[np.ndarray, " 3"]]:
    """Sign patterns that give every direction along `offset` once, up to reversal."""
    axes = np.flatnonzero(offset)
    patterns = []
    for bits in range(2 ** (len(axes) - 1)):
        signs = np.ones(3, int)
        for bit, axis in enumerate(axes[1:]):
            signs[axis] = -1 if bits >> bit & 1 else 1
        patterns.append(signs)
    return patterns


def _pair_views(
    shape: tuple[int, ...], offset: Int[np.ndarray, " 3"]
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of all nodes that have a neighbour at `offset`, and of those neighbours."""
    low = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, shape, strict=True))
    high = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, shape, strict=True))
    return low, high


def make_well_composed(
    field: Float32[np.ndarray, "nx ny nz"], labels: UInt8[np.ndarray, "nx ny nz"]
) -> None:
    """Flip nodes, in place, until the labelled set is well-composed.

    Of the corners of a critical cell the one nearest to the surface flips. After a few rounds nodes
    are only removed, which ends at the latest with the empty set.

    Args:
        field: [cells], negative inside, C-contiguous.
        labels: the same shape; no cell holds two labels and the outer three layers are empty.
    """
    _, ny, nz = labels.shape
    corner_steps = CORNERS @ np.array([ny * nz, nz, 1])
    flat_labels = labels.reshape(-1)
    codes = np.zeros(labels.shape, np.uint8)
    codes[:-1, :-1, :-1] = cell_codes(labels != NO_COMPONENT)
    cells = np.flatnonzero(CRITICAL_CODES[codes])
    round_number = 0
    while len(cells):
        chosen = _flip_nodes(field, labels, cells[:, None] + corner_steps, round_number)
        cells = np.unique((chosen[:, None] - corner_steps).reshape(-1))
        inside = flat_labels[cells[:, None] + corner_steps] != NO_COMPONENT
        cells = cells[CRITICAL_CODES[inside @ BITS]]
        round_number += 1


def _flip_nodes(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    corners: Int[np.ndarray, "cells 8"],
    round_number: int,
) -> Int[np.ndarray, " nodes"]:
    """Flip one corner of each critical cell in place; flat indices of the flipped nodes.

    A node is added only where the 5x5x5 nodes around hold one label, so that two nodes added at
    once never clash.
    """
    _, ny, nz = labels.shape
    flat_field, flat_labels = field.reshape(-1), labels.reshape(-1)
    inside = flat_labels[corners] != NO_COMPONENT
    around = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    near = flat_labels[corners[..., None] + around @ np.array([ny * nz, nz, 1])]
    lowest = near.min(axis=2)
    if round_number < FREE_ROUNDS:
        single = ((near == lowest[..., None]) | (near == NO_COMPONENT)).all(axis=2)
        allowed = (inside | single) & CRITICAL[inside @ BITS]
    else:
        allowed = inside
    cost = np.where(allowed, np.abs(flat_field[corners]), np.inf)
    pick = (np.arange(len(corners)), cost.argmin(axis=1))
    chosen, first = np.unique(corners[pick], return_index=True)
    was_inside = inside[pick][first]
    flat_labels[chosen] = np.where(was_inside, NO_COMPONENT, lowest[pick][first])
    flat_field[chosen] = np.where(was_inside, NEAR_ZERO, -NEAR_ZERO)
    return chosen


def well_composed_genus(inside: Bool[np.ndarray, "nx ny nz"], *, shells: int | None = None) -> int:
    """First Betti number of a well-composed set: handles, and those of its hollows.

    Its contour has a vertex a crossed cell, a quad a crossed edge and twice as many edges, so its
    Euler characteristic is cells - crossed edges; b1 is the sum of 1 - chi / 2 over its shells.

    Args:
        inside: the set.
        shells: lumps and hollows of it, where they are known; counted otherwise.
    """
    codes = cell_codes(inside)
    cells = np.count_nonzero((codes != 0) & (codes != 255))
    rows = (np.moveaxis(inside, axis, 0) for axis in range(3))
    edges = sum(np.count_nonzero(row[1:] != row[:-1]) for row in rows)
    known = shells
    if known is None:
        ndimage = require_package("scipy.ndimage", extra="sim")
        known = int(ndimage.label(inside)[1] + ndimage.label(~inside)[1] - 1)
    return int(known - (cells - edges) // 2)
