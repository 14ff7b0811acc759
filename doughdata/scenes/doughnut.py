"""A doughnut: g = 1 may become 0 or 2, and it may fall into pieces."""

import numpy as np

from doughdata.scenes.sampling import between, sample_action, sample_scene
from doughschemas import Action, Body, Scene, Tool

__all__ = ["Doughnut"]


class Doughnut:
    """One ring, round to elongated, squeezed across its hole or through its tube."""

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


def _action(bodies: tuple[Body, ...], tool: Tool, rng: np.random.Generator) -> Action:
    radius = float(bodies[0].parameters["ring_radius"])
    return sample_action(tool, rng, reach=(radius, radius), yaw=np.pi / 2, opening=0.016)
