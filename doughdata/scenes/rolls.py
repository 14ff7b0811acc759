"""Two rolls of dough side by side: c = 2 may become 1, 2, 3 or 4."""

from dataclasses import replace

import numpy as np

from doughdata.scenes.sampling import CUTS, Draft, between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["Rolls"]

# Gaps [m]. Rolls that are near merge before they are cut: halves stay together in pairs. Only far
# ones, on a table that holds them, are cut before they meet: 3 pieces, or 4.
NEAR, FAR = (0.001, 0.006), (0.024, 0.036)
SHARE_FAR = 0.6
MOST_SHIFT = 0.35  # of the length, of each roll along the other
# Where the fingers come down along the rolls: where both lie, so that a blade cuts both (4 pieces);
# where one lies alone, well inside it (on a table that holds it mostly to cut it: 3 pieces); else
# anywhere, perhaps on an end.
SHARE_BOTH, SHARE_ONE, CUTS_ONE = 0.45, 0.35, 0.8
INSIDE = 0.010  # [m] from either end of a roll that is caught alone


class Rolls:
    """Two equal rolls along y, 1-36 mm apart and shifted along each other, squeezed across."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "rolls", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    radius = between(0.008, 0.014, scale)
    length = between(0.040, 0.080, rng.random())
    parameters = {"radius": radius, "length": length, "exponent": between(2.0, 8.0, rng.random())}
    gap = FAR if rng.random() < SHARE_FAR else NEAR
    x = radius + between(*gap, rng.random()) / 2
    y = between(-MOST_SHIFT, MOST_SHIFT, rng.random()) * length
    return tuple(
        Body(shape="roll", parameters=parameters, position=(s * x, round(s * y, 6)))
        for s in (-1, 1)
    )


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    length = float(draft.bodies[0].parameters["length"])
    shift = abs(draft.bodies[0].position[1])
    turn, where = np.radians(25), rng.random()
    alone = (0.5 * length - shift + draft.tool.width / 2, 0.5 * length + shift - INSIDE)
    if where < SHARE_ONE and draft.cutter and alone[0] < alone[1]:
        cuts = CUTS_ONE if draft.bare else CUTS
        action = sample_action(
            draft.tool, rng, reach=(0.006, 0.0), yaw=turn, opening=0.020, cuts=cuts
        )
        y = between(*alone, rng.random()) * float(rng.choice((-1, 1)))
        return replace(action, position=(action.position[0], y))
    both = where < SHARE_ONE + SHARE_BOTH
    reach = 0.40 * length - shift if both else 0.42 * length + shift
    return sample_action(draft.tool, rng, reach=(0.006, reach), yaw=turn, opening=0.020)
