"""Two rolls of dough side by side: c = 2 may become 1, 2, 3 or 4."""

import numpy as np

from doughdata.scenes.sampling import between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["Rolls"]


class Rolls:
    """Two equal rolls along y, 1-6 mm apart, squeezed across."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "rolls", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    radius = between(0.008, 0.014, scale)
    parameters = {
        "radius": radius,
        "length": between(0.040, 0.080, rng.random()),
        "exponent": between(2.0, 8.0, rng.random()),
    }
    x = radius + between(0.001, 0.006, rng.random()) / 2
    return tuple(Body(shape="roll", parameters=parameters, position=(s * x, 0.0)) for s in (-1, 1))


def _action(bodies: tuple[Body, ...], rng: np.random.Generator) -> Action:
    length = float(bodies[0].parameters["length"])
    return sample_action(rng, reach=(0.010, 0.35 * length), yaw=np.radians(25), opening=0.020)
