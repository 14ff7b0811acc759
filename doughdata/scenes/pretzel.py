"""A pretzel: genus 2 or 3 that squeezing may close, open or multiply."""

import numpy as np

from doughdata.scenes.sampling import Draft, between, sample_action, sample_scene
from doughschemas import Action, Body, Scene

__all__ = ["Pretzels"]


class Pretzels:
    """Two or three holes in a row along y, squeezed across a hole or through a tube."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split."""
        return sample_scene(
            "pretzel", seed=seed, number=number, split=split, bodies=_bodies, action=_action
        )


def _bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
    # Every hole is at least 14 mm wide: it stays open while the dough settles, and is far from the
    # 6 mm between 2 mm particles below which the check sees no hole.
    parameters = {
        "holes": int(rng.integers(2, 4)),
        "ring_radius": between(0.014, 0.018, scale),
        "tube_radius": between(0.0055, 0.0070, rng.random()),
    }
    return (Body(shape="pretzel", parameters=parameters),)


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    parameters = draft.bodies[0].parameters
    radius = float(parameters["ring_radius"])
    along = radius * (float(parameters["holes"]) - 0.5)
    return sample_action(draft.tool, rng, reach=(radius, along), yaw=np.radians(30), opening=0.016)
