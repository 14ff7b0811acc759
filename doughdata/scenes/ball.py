"""A ball of dough: c = 1 may become 2."""

import numpy as np

from doughdata.scenes.sampling import Draft, between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["SingleBall"]


class SingleBall:
    """One ball, round to flattened, squeezed or cut from any side."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "ball", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    parameters = {
        "radius": between(0.012, 0.020, scale),  # volumes near those of the rolls
        "flatness": between(0.6, 1.0, rng.random()),
    }
    return (Body(shape="ball", parameters=parameters),)


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    reach = 0.6 * float(draft.bodies[0].parameters["radius"])
    return sample_action(draft.tool, rng, reach=(reach, reach), yaw=np.pi, opening=0.018)
