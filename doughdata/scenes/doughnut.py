"""A doughnut: g = 1 may become 0 or 2, and it may fall into pieces."""

from dataclasses import replace

import numpy as np

from doughdata.scenes.sampling import Draft, between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["Doughnut"]


# Squeezes anywhere on a ring mostly cut its tube. A figure eight (g = 2) and two rings need fingers
# that meet in the middle of the hole, and the eight an opening at which the walls merge and hold.
# On a floured table the walls come together; on a bare one the fingers plough through them.
CENTRED, CENTRED_FLOURED, OFF_CENTRE = 0.5, 0.75, 0.15  # of the scenes; of the ring's radius
PINCHED, PINCHED_FLOURED, PINCH = 0.5, 0.75, (0.004, 0.008)  # of the centred; final opening [m]


class Doughnut:
    """One ring, round to elongated: squeezed across its hole, or anywhere through its tube."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "doughnut", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    parameters = {
        "ring_radius": between(0.018, 0.030, scale),
        "tube_radius": between(0.006, 0.012, rng.random()),
        "elongation": between(0.8, 1.25, rng.random()),
        "exponent": between(2.0, 8.0, rng.random()),
    }
    return (Body(shape="ring", parameters=parameters),)


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    radius = float(draft.bodies[0].parameters["ring_radius"])
    centred = rng.random() < (CENTRED if draft.bare else CENTRED_FLOURED)
    reach = OFF_CENTRE * radius if centred else radius
    action = sample_action(draft.tool, rng, reach=(reach, reach), yaw=np.pi / 2, opening=0.016)
    pinched = rng.random() < (PINCHED if draft.bare else PINCHED_FLOURED)
    if centred and pinched and draft.cutter:
        return replace(action, opening_end=between(*PINCH, rng.random()))
    return action
