"""One roll of dough: c = 1 may become 2."""

import numpy as np

from doughdata.scenes.sampling import Draft, between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["SingleRoll"]


class SingleRoll:
    """One roll along y, squeezed or cut across at any yaw up to 45 degrees."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "roll", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    parameters = {
        "radius": between(0.008, 0.014, scale),
        "length": between(0.040, 0.080, rng.random()),
        "exponent": between(2.0, 8.0, rng.random()),
    }
    return (Body(shape="roll", parameters=parameters),)


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    length = float(draft.bodies[0].parameters["length"])
    return sample_action(
        draft.tool, rng, reach=(0.010, 0.35 * length), yaw=np.radians(45), opening=0.015
    )
