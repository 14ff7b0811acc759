"""One look at one component: how many handles it has, and how sure that is.

Handles are loops that last while balls around the particles grow (`alpha.py`). Unmerged contacts
are kept open by walls, which may open a loop but make no handle: the truth is not above what is
read with walls, nor below what is read both with and without them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from doughdata.topology.alpha import AlphaComplex
from doughdata.topology.crops import SIDE_BOND
from doughdata.topology.pairs import encode, lengths
from doughdata.topology.solids import Closing, Solid, solid_genus
from doughdata.topology.walls import find_walls

__all__ = ["LoopWindow", "Reading", "has_no_loop", "read_component", "solid_with"]

BRIDGE = SIDE_BOND  # [spacings]; a longer pair without a bond may lie across a gap
EARLIER = 0.2  # [spacings]; by so much radii are tried before a loop's death
CUT = 2.0  # [spacings], radius of balls that bridge the cut of a blade
# [spacings], of closings; the first with the genus that was read gives the skeleton.
SOLID_RADII = (1.75, 1.5, 2.0, 2.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopWindow:
    """Which loops are holes; radii in spacings of balls around the particles."""

    birth: float  # a hole's rim is closed at this radius
    death: float  # a hole is not yet filled at this radius
    doubt: float  # windows so much wider and narrower on both sides must have the same

    @property
    def nested(self) -> list[tuple[float, float]]:
        """The wider window, the window, the narrower one."""
        steps = (self.doubt, 0.0, -self.doubt)
        return [(self.birth - step, self.death + step) for step in steps]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What was read from one component in one key frame."""

    genus: int  # with walls
    lowest: int  # what all windows leave of the genus; above `highest` where they differ
    highest: int
    floor: int  # what any window leaves of it
    ceiling: int
    parted: bool  # without walls there would be more handles
    firm: bool  # one value for all sizes of holes, and no handle that only walls make
    walls: Int64[np.ndarray, "walls 2"]  # of the component's particles

    @property
    def range(self) -> tuple[int, int, int]:
        """What two readings must share to be of one span."""
        return self.genus, self.lowest, self.highest


def read_component(
    x: Float64[np.ndarray, "members 3"],
    bonds: Int64[np.ndarray, "bonds 2"],
    contacts: Int64[np.ndarray, "contacts 2"],
    spacing: float,
    window: LoopWindow,
) -> Reading:
    """Read one component [m]; `bonds` are its short ones, `contacts` its unmerged near pairs."""
    if not len(contacts) and has_no_loop(x, spacing, window):
        return Reading(
            genus=0,
            lowest=0,
            highest=0,
            floor=0,
            ceiling=0,
            parted=False,
            firm=True,
            walls=np.zeros((0, 2), np.int64),
        )
    widest = 2 * max(death for _, death in window.nested)
    grown = AlphaComplex.of(x / spacing)
    near = grown.ends[grown.edges <= widest / 2]
    long = lengths(x, near) > BRIDGE * spacing  # none of them is among the bonds, which are short
    walls = find_walls(x, bonds, contacts, near[long], spacing=spacing, widest=widest * spacing)
    none = np.zeros(0, np.int64)
    closed = opened = grown.lasting(window.nested, without=none)
    bridged = 0
    if len(walls):
        opened = grown.lasting(window.nested, without=encode(walls, len(x)))
        (bridged,) = grown.lasting([(CUT, CUT)], without=none)
    least = [min(pair) for pair in zip(opened, closed, strict=True)]
    return Reading(
        genus=opened[1],
        lowest=max(least),
        highest=min(opened),
        floor=min(least),
        ceiling=max(opened),
        parted=max(bridged, closed[1]) > opened[1],
        firm=len({*opened, *least}) == 1,
        walls=walls,
    )


def has_no_loop(x: Float64[np.ndarray, "members 3"], spacing: float, window: LoopWindow) -> bool:
    """Whether the balls leave no loop, from well before the deaths of all windows to the last.

    Then none lasts through any window. On voxels, without a tetrahedralisation.
    """
    deaths = [death for _, death in window.nested]
    radii = np.linspace(min(deaths) - EARLIER, max(deaths), 3)
    around = Closing(x, spacing, largest=max(deaths)).distance / spacing
    return all(solid_genus(around < radius) == 0 for radius in radii)


def solid_with(
    x: Float64[np.ndarray, "members 3"],
    walls: Int64[np.ndarray, "walls 2"],
    spacing: float,
    genus: int,
) -> Solid:
    """The first closing of a component [m] with this genus, else one with few handles more."""
    closing = Closing(x, spacing, largest=max(SOLID_RADII))
    found: list[tuple[int, int, Solid]] = []
    for order, radius in enumerate(SOLID_RADII):
        solid = closing.opened(closing.solid(radius), walls)
        more = solid_genus(solid.inside) - genus
        if more == 0:
            return solid
        found.append((more if more > 0 else len(x) - more, order, solid))
    return min(found, key=lambda one: one[:2])[2]
