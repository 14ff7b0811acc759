"""The solid of one component: the closing of its particles that has the genus of its label.

Whether touching parts are merged is for the topology check to say. So the closing is tried as it is
first; where its genus is not the label's, the seams that the check names are opened one by one,
then other closing radii are tried, and the nearest genus wins. Lengths are in cells unless said.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from doughdata.mesh.distance import closing_field, level_for_volume
from doughdata.mesh.lumps import bridge_lumps, drop_lumps, fill_cavities, find_lumps
from doughdata.mesh.repair import make_well_composed, separate, well_composed_genus
from doughdata.mesh.sharpen import sharpen
from doughdata.mesh.walls import carve_gaps, cut_slits, seams_of
from doughschemas import NO_COMPONENT

__all__ = ["SolidConfig", "component_field", "tidy"]

SEAM_REACH = 1.5  # spacings; touching particles this near are of one seam
NODE_ZERO = 1e-3  # a crossing exactly on a node would make empty triangles


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidConfig:
    """How particles become a solid. Lengths are in particle spacings at rest."""

    cells_per_spacing: float = 1.6  # cell size = spacing / this
    closing_radius: float = 1.5  # gaps narrower than about twice this are closed
    # tried in this order where the genus is not that of the label
    other_radii: tuple[float, ...] = (1.75, 2.0, 1.25, 2.25, 2.5, 1.625, 1.875)
    level_low: float = 0.3  # least distance of the surface from the outermost particles
    level_high: float = 1.0  # greatest
    lump_share: float = 0.02  # smaller lumps of a component, against its largest, are dropped
    sharp: bool = False  # convex edges get their corner back, where the genus allows


def component_field(
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
    shape: tuple[int, int, int],
    *,
    genus: int,
    config: SolidConfig,
) -> Float32[np.ndarray, "nx ny nz"]:
    """Signed distance to the solid of one component, repaired, negative inside.

    Args:
        cloud: particles on the lattice of the field.
        pairs: indices into the cloud of pairs that touch without being merged.
        shape: nodes along each axis.
        genus: of the label.
        config: see SolidConfig.
    """
    best, error = _best_closing(cloud, pairs, shape, genus, config)
    if not config.sharp:
        return best
    sharp = _sharpened(best, len(cloud), config)
    if sharp is None or abs(_tidied_genus(sharp, config) - genus) > error:
        return best
    return sharp


def _best_closing(
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
    shape: tuple[int, int, int],
    genus: int,
    config: SolidConfig,
) -> tuple[Float32[np.ndarray, "nx ny nz"], int]:
    """The first closing of the genus wanted, else the nearest, and by how much it is wrong."""

    def closing(radius: float) -> Float32[np.ndarray, "nx ny nz"]:
        per = config.cells_per_spacing
        return closing_field(cloud, shape, radius=radius * per, level=0.5 * per)

    base = closing(config.closing_radius)
    opened = pairs[:0]
    best, error = _finish(base, cloud, opened, genus, config)
    for seam in seams_of(cloud, pairs, reach=SEAM_REACH * config.cells_per_spacing):
        if error == 0:
            return best, error
        trial = np.concatenate([opened, seam])
        field, found = _finish(base, cloud, trial, genus, config)
        if found < error:
            best, error, opened = field, found, trial
    # A seam opened in vain at the first radius may be what is wrong at the others.
    choices = [opened, pairs[:0]] if len(opened) else [opened]
    for radius in config.other_radii:
        if error == 0:
            return best, error
        other = closing(radius)
        for seams in choices:
            field, found = _finish(other, cloud, seams, genus, config)
            if found < error:
                best, error = field, found
    return best, error


def _finish(
    closing: Float32[np.ndarray, "nx ny nz"],
    cloud: Float[np.ndarray, "members 3"],
    pairs: Int[np.ndarray, "pairs 2"],
    genus: int,
    config: SolidConfig,
) -> tuple[Float32[np.ndarray, "nx ny nz"], int]:
    """Field with the particles' volume, pairs kept open, repaired; and how far off its genus is."""
    per = config.cells_per_spacing
    field = closing.copy()
    if len(pairs):
        carve_gaps(field, cloud, pairs, level=0.5 * per)
    level = level_for_volume(
        field, len(cloud) * per**3, low=config.level_low * per, high=config.level_high * per
    )
    field -= np.float32(level)
    if len(pairs):
        cut_slits(field, cloud, pairs)
    return field, abs(_tidied_genus(field, config) - genus)


def _sharpened(
    field: Float32[np.ndarray, "nx ny nz"], particles: int, config: SolidConfig
) -> Float32[np.ndarray, "nx ny nz"] | None:
    """The field with sharp edges and the particles' volume; None where it has no edge."""
    per = config.cells_per_spacing
    sharp = sharpen(field, per=per)
    if sharp is not None:
        reach = (config.level_high - config.level_low) * per
        sharp -= np.float32(level_for_volume(sharp, particles * per**3, low=-reach, high=reach))
    return sharp


def _tidied_genus(field: Float32[np.ndarray, "nx ny nz"], config: SolidConfig) -> int:
    """Repair the field of one component in place; the genus that it then has."""
    labels = np.where(field < 0.0, np.uint8(0), np.uint8(NO_COMPONENT))
    lumps = tidy(field, labels, config)
    return well_composed_genus(labels != NO_COMPONENT, shells=lumps)


def tidy(
    field: Float32[np.ndarray, "nx ny nz"],
    labels: UInt8[np.ndarray, "nx ny nz"],
    config: SolidConfig,
) -> int:
    """Repair in place: apart, well-composed, joined where it should be, no splinters or hollows.

    Returns:
        How many lumps are left.
    """
    near = np.abs(field) < NODE_ZERO
    field[near] = np.where(labels[near] == NO_COMPONENT, NODE_ZERO, -NODE_ZERO)
    separate(field, labels)
    make_well_composed(field, labels)
    reach = 2.0 * config.closing_radius * config.cells_per_spacing
    lumps = find_lumps(labels, share=config.lump_share)
    if bridge_lumps(field, labels, lumps, reach=reach):
        separate(field, labels)
        make_well_composed(field, labels)
        lumps = find_lumps(labels, share=config.lump_share)
    drop_lumps(field, labels, lumps)
    fill_cavities(field, labels)
    return int(np.count_nonzero(lumps.counts))
