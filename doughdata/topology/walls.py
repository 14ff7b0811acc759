"""Walls: where a closing would bridge two surfaces that are no one piece.

A closing fills narrow gaps. Where the particles on both sides of a filled gap, or of a contact, are
bonded to each other nearby, that is right: a fold, the rim of a seam, a thin place. Where they
are not, the gap is real and the solid has to stay open.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.ndimage import label
from scipy.spatial import cKDTree

from doughdata.topology.crops import cells_along, chunks
from doughdata.topology.pairs import connected

__all__ = ["find_walls"]

LOCAL = 0.004  # [m]; sides that join within this of a gap are one
CHUNK = 0.006  # [m], length of a gap that is judged at once
LINK = 2.2  # [spacings], contact particles this near are one patch
REACH = 2.2  # [spacings], from a filled gap to the particles beside it
FEWEST = 6  # particles of a side, voxels of a gap; fewer are noise


def find_walls(
    positions: Float64[np.ndarray, "particles 3"],
    bonds: Int64[np.ndarray, "bonds 2"],
    contacts: Int64[np.ndarray, "contacts 2"],
    gaps: Float64[np.ndarray, "voxels 3"],
    *,
    spacing: float,
    voxel: float,
    widest: float,
) -> Int64[np.ndarray, "walls 2"]:
    """Pairs of particles of one component between which the solid must stay open.

    `bonds` are short bonded pairs, `contacts` unmerged near pairs, `gaps` the centres [m] of
    voxels (edge `voxel` [m]) that only the closing has filled, `widest` [m] the widest gap that it
    fills.
    """
    tree = cKDTree(positions)
    cores = [
        np.unique(contacts[rows])
        for rows in chunks(
            positions, contacts, longest=np.inf, link=LINK * spacing, length=CHUNK
        )
    ]
    for lump in _lumps(gaps, voxel):
        near = tree.query_ball_point(lump, REACH * spacing)
        cores.append(np.unique(np.concatenate([np.asarray(n, dtype=np.int64) for n in near])))
    found = [np.zeros((0, 2), np.int64)]
    for core in cores:
        if len(core) >= 2 * FEWEST:
            found += _facing(positions, bonds, tree, core, widest)
    return np.unique(np.concatenate(found), axis=0)


def _lumps(
    gaps: Float64[np.ndarray, "voxels 3"], voxel: float
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Connected groups of filled voxels, cut along their main axis."""
    if len(gaps) < FEWEST:
        return []
    index = np.rint((gaps - gaps.min(axis=0)) / voxel).astype(int)
    grid = np.zeros(index.max(axis=0) + 1, dtype=bool)
    grid[tuple(index.T)] = True
    lump = label(grid, np.ones((3, 3, 3)))[0][tuple(index.T)]
    found = []
    for number in np.unique(lump):
        part = gaps[lump == number]
        if len(part) >= FEWEST:
            cell = cells_along(part, CHUNK)
            found += [part[cell == k] for k in np.unique(cell)]
    return found


def _facing(
    positions: Float64[np.ndarray, "particles 3"],
    bonds: Int64[np.ndarray, "bonds 2"],
    tree: cKDTree,
    core: Int64[np.ndarray, " core"],
    widest: float,
) -> list[Int64[np.ndarray, "walls 2"]]:
    """All pairs up to `widest` [m] of the locally separate sides that meet in a core."""
    inside = _around(positions, tree, core)
    piece = _pieces(bonds, inside, len(positions))
    numbers, sizes = np.unique(piece[core], return_counts=True)
    sides = [np.flatnonzero(piece == n) for n in numbers[sizes >= FEWEST]]
    found = []
    for k, first in enumerate(sides):
        for second in sides[k + 1 :]:
            close = cKDTree(positions[first]).sparse_distance_matrix(
                cKDTree(positions[second]), widest, output_type="ndarray"
            )
            pairs = np.stack([first[close["i"]], second[close["j"]]], axis=1)
            found.append(np.sort(pairs, axis=1))
    return found


def _around(
    positions: Float64[np.ndarray, "particles 3"], tree: cKDTree, core: Int64[np.ndarray, " core"]
) -> Bool[np.ndarray, " particles"]:
    low, high = positions[core].min(axis=0), positions[core].max(axis=0)
    box = np.asarray(
        tree.query_ball_point((low + high) / 2, float(np.linalg.norm(high - low)) / 2 + LOCAL),
        dtype=np.int64,
    )
    distance, _ = cKDTree(positions[core]).query(positions[box], distance_upper_bound=LOCAL)
    inside = np.zeros(len(positions), dtype=bool)
    inside[box[np.isfinite(distance)]] = True
    return inside


def _pieces(
    bonds: Int64[np.ndarray, "bonds 2"], inside: Bool[np.ndarray, " particles"], count: int
) -> Int32[np.ndarray, " particles"]:
    """Bonded piece of every particle inside; -1 elsewhere."""
    piece = connected(bonds[inside[bonds].all(axis=1)], count).astype(np.int32)
    piece[~inside] = -1
    return piece
