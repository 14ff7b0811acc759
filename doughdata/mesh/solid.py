"""From particles to one labelled signed-distance grid that every mesher contours."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Float32, Float64, Int, Int64, UInt8

from doughdata.mesh.component import SolidConfig, component_field, tidy
from doughdata.mesh.lumps import seed_missing
from doughschemas import NO_COMPONENT, BadInputError, FrameTopology

__all__ = ["Solid", "build_solid", "shifted_field"]

MARGIN = 0.02  # [cells], a shifted field stays this far from zero, so that no node changes sides
FAR = 1e3  # [cells], field where no component is near


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """Signed distances and labels on a lattice whose node i lies at (origin + i) * cell."""

    field: Float32[np.ndarray, "nx ny nz"]  # [cells], negative where `labels` names a component
    labels: UInt8[np.ndarray, "nx ny nz"]  # component of an inside node, else NO_COMPONENT
    origin: Int64[np.ndarray, " 3"]  # [cells], world
    cell: float  # [m]
    volumes: Float64[np.ndarray, " components"]  # [cells^3] that the particles stand for


def build_solid(
    positions: Float32[np.ndarray, "particles 3"],
    topology: FrameTopology,
    *,
    spacing: float,
    config: SolidConfig,
) -> Solid:
    """Closing of every component, kept apart, well-composed, without cavities.

    Args:
        positions: [m], world.
        topology: labels of the particles and the contacts to keep open; strays are ignored.
        spacing: of the particles at rest [m].
        config: see SolidConfig.

    Raises:
        BadInputError: positions of a component that are not finite.
    """
    per = config.cells_per_spacing
    cell = spacing / per
    members = _members(positions, topology)
    clouds = [np.asarray(positions[m], np.float64) / cell for m in members]
    pairs = [_pairs_within(topology.contacts, m, len(positions)) for m in members]
    used = np.concatenate([*clouds, np.zeros((0 if any(map(len, clouds)) else 1, 3))])
    margin = _margin(config)
    origin = np.floor(used.min(axis=0)).astype(np.int64) - margin
    shape = tuple((np.ceil(used.max(axis=0)).astype(np.int64) + margin - origin + 1).tolist())
    clouds = [cloud - origin for cloud in clouds]
    field, labels = _combine(clouds, pairs, shape, topology.genus, config)
    seed_missing(field, labels, clouds)
    volumes = np.array([len(cloud) for cloud in clouds], float) * per**3
    return Solid(field=field, labels=labels, origin=origin, cell=cell, volumes=volumes)


def _margin(config: SolidConfig) -> int:
    """Nodes around the particles of a component that its closings and the repair need."""
    radius = max(config.closing_radius, *config.other_radii, 0.0)
    return max(int(np.ceil(radius * config.cells_per_spacing)) + 2, 6)


def _pairs_within(
    contacts: Int[np.ndarray, "contacts 2"], members: Int[np.ndarray, " members"], count: int
) -> Int[np.ndarray, "pairs 2"]:
    """Contacts between two members, as indices into `members`."""
    rank = np.full(count, -1)
    rank[members] = np.arange(len(members))
    pairs = rank[contacts.reshape(-1, 2)]
    return pairs[(pairs >= 0).all(axis=1)]


def _members(
    positions: Float32[np.ndarray, "particles 3"], topology: FrameTopology
) -> list[Int[np.ndarray, " _"]]:
    count = topology.num_components
    members = [np.flatnonzero(topology.labels == k) for k in range(count)]
    for label, particles in enumerate(members):
        if not np.isfinite(positions[particles]).all():
            raise BadInputError(f"positions of component {label} must be finite; simulate again")
    return members


def _combine(
    clouds: list[Float[np.ndarray, "_ 3"]],
    pairs: list[Int[np.ndarray, "_ 2"]],
    shape: tuple[int, ...],
    genus: tuple[int, ...],
    config: SolidConfig,
) -> tuple[Float32[np.ndarray, "nx ny nz"], UInt8[np.ndarray, "nx ny nz"]]:
    """Field and labels of all components; where two are near, the surface is halfway."""
    margin = _margin(config)
    best = np.full(shape, FAR, np.float32)
    second = np.full(shape, FAR, np.float32)
    labels = np.full(shape, NO_COMPONENT, np.uint8)
    boxes = []
    for label, cloud in enumerate(clouds):
        if not len(cloud):
            continue
        low = np.floor(cloud.min(axis=0)).astype(int) - margin
        high = np.ceil(cloud.max(axis=0)).astype(int) + margin + 1
        size = (int(high[0] - low[0]), int(high[1] - low[1]), int(high[2] - low[2]))
        field = component_field(cloud - low, pairs[label], size, genus=genus[label], config=config)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        boxes.append((low, high))
        wins = field < best[box]
        second[box] = np.minimum(np.where(wins, best[box], field), second[box])
        best[box] = np.where(wins, field, best[box])
        labels[box][wins] = label
    field = np.maximum(best, 0.5 * (best - second))
    labels[field >= 0.0] = NO_COMPONENT
    # Each is repaired already, and stays so where the others are out of reach.
    if any(_boxes_meet(a, b) for a, b in combinations(boxes, 2)):
        tidy(field, labels, config)
    return field, labels


def _boxes_meet(
    one: tuple[Int[np.ndarray, " 3"], Int[np.ndarray, " 3"]],
    two: tuple[Int[np.ndarray, " 3"], Int[np.ndarray, " 3"]],
) -> bool:
    """Whether two boxes of nodes share a node."""
    return bool((one[0] < two[1]).all() and (two[0] < one[1]).all())


def shifted_field(
    solid: Solid, shift: Float64[np.ndarray, " components"]
) -> Float32[np.ndarray, "nx ny nz"]:
    """Field whose zero level lies `shift` [cells] further out, with every node on its old side."""
    near = solid.labels.copy()  # label of the component at or beside each node
    for axis in range(3):
        rows = np.moveaxis(near, axis, 0)
        before = rows.copy()
        np.minimum(rows[1:], before[:-1], out=rows[1:])
        np.minimum(rows[:-1], before[1:], out=rows[:-1])
    table = np.zeros(NO_COMPONENT + 1, np.float32)
    table[: len(shift)] = shift
    moved = solid.field - table[near]
    inside = solid.labels != NO_COMPONENT
    return np.where(inside, np.minimum(moved, -MARGIN), np.maximum(moved, MARGIN))
