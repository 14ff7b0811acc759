"""From particles to one labelled signed-distance grid that every mesher contours."""

from dataclasses import dataclass

import numpy as np
from doughschemas import NO_COMPONENT, BadInputError, FrameTopology
from jaxtyping import Float, Float32, Float64, Int, Int64, UInt8

from doughdata.mesh.distance import closing_field, level_for_volume
from doughdata.mesh.lumps import bridge_lumps, drop_lumps, fill_cavities, seed_missing
from doughdata.mesh.repair import make_well_composed, separate
from doughdata.mesh.walls import carve_gaps, cut_slits

__all__ = ["Solid", "SolidConfig", "build_solid", "shifted_field"]

MARGIN = 0.02  # [cells], a shifted field stays this far from zero, so that no node changes sides
FAR = 1e3  # [cells], field where no component is near


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidConfig:
    """How particles become a solid. Lengths are in particle spacings at rest."""

    cells_per_spacing: float = 1.6  # cell size = spacing / this
    closing_radius: float = 1.5  # gaps narrower than about twice this are closed
    level_low: float = 0.3  # least distance of the surface from the outermost particles
    level_high: float = 1.0  # greatest
    lump_share: float = 0.02  # smaller lumps of a component, against its largest, are dropped


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
    margin = _margin(config) + 2  # the repair looks two nodes further
    origin = np.floor(used.min(axis=0)).astype(np.int64) - margin
    shape = tuple((np.ceil(used.max(axis=0)).astype(np.int64) + margin - origin + 1).tolist())
    clouds = [cloud - origin for cloud in clouds]
    field, labels = _combine(clouds, pairs, shape, config)
    _tidy(field, labels, config)
    seed_missing(field, labels, clouds)
    volumes = np.array([len(cloud) for cloud in clouds], float) * per**3
    return Solid(field=field, labels=labels, origin=origin, cell=cell, volumes=volumes)


def _margin(config: SolidConfig) -> int:
    """Nodes around the particles of a component that its closing needs."""
    return int(np.ceil(config.closing_radius * config.cells_per_spacing)) + 2


def _tidy(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    config: SolidConfig,
) -> None:
    """Repair in place: apart, well-composed, joined where it should be, no splinters or hollows."""
    separate(field, labels)
    make_well_composed(field, labels)
    reach = 2.0 * config.closing_radius * config.cells_per_spacing
    if bridge_lumps(field, labels, share=config.lump_share, reach=reach):
        separate(field, labels)
        make_well_composed(field, labels)
    drop_lumps(field, labels, share=config.lump_share)
    fill_cavities(field, labels)


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
    config: SolidConfig,
) -> tuple[Float32[np.ndarray, "nx ny nz"], UInt8[np.ndarray, "nx ny nz"]]:
    """Field and labels of all components; where two are near, the surface is halfway."""
    margin = _margin(config)
    best = np.full(shape, FAR, np.float32)
    second = np.full(shape, FAR, np.float32)
    labels = np.full(shape, NO_COMPONENT, np.uint8)
    for label, cloud in enumerate(clouds):
        if not len(cloud):
            continue
        low = np.floor(cloud.min(axis=0)).astype(int) - margin
        high = np.ceil(cloud.max(axis=0)).astype(int) + margin + 1
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        field = _component_field(cloud - low, pairs[label], config)
        wins = field < best[box]
        second[box] = np.minimum(np.where(wins, best[box], field), second[box])
        best[box] = np.where(wins, field, best[box])
        labels[box][wins] = label
    field = np.maximum(best, 0.5 * (best - second))
    labels[field >= 0.0] = NO_COMPONENT
    small = np.abs(field) < 1e-3  # a crossing exactly on a node would make empty triangles
    field[small] = np.where(labels[small] == NO_COMPONENT, 1e-3, -1e-3)
    return field, labels


def _component_field(
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
    config: SolidConfig,
) -> Float32[np.ndarray, "nx ny nz"]:
    """Closing of one cloud, its zero level set where the volume fits the particle count."""
    per = config.cells_per_spacing
    high = np.ceil(cloud.max(axis=0)).astype(int) + _margin(config) + 1
    shape = (int(high[0]), int(high[1]), int(high[2]))
    field = closing_field(cloud, shape, radius=config.closing_radius * per, level=0.5 * per)
    if len(pairs):
        carve_gaps(field, cloud, pairs, level=0.5 * per)
    level = level_for_volume(
        field, len(cloud) * per**3, low=config.level_low * per, high=config.level_high * per
    )
    field -= np.float32(level)
    if len(pairs):
        cut_slits(field, cloud, pairs)
    return field


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
