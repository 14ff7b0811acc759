"""Two rolls of dough side by side: c = 2 may become 1, 2, 3 or 4."""

import numpy as np

from doughdata.scenes.sampling import between, sample_action, sample_scene
from doughschemas import Action, Body, Scene, Tool

__all__ = ["Rolls"]

# Gaps [m]. Rolls that are near merge before they are cut: halves stay together in pairs. Only far
# ones, on a table that holds them, are cut before they meet: 3 pieces, or 4.
NEAR, FAR = (0.001, 0.006), (0.024, 0.036)
SHARE_FAR = 0.6
# Half of the squeezes lie where both rolls do, so that a blade cuts both: 4 pieces. The others lie
# anywhere along either roll: one of them is missed, or only its end is caught.
SHARE_BOTH = 0.5


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
    y = between(-0.2, 0.2, rng.random()) * length
    return tuple(
        Body(shape="roll", parameters=parameters, position=(s * x, round(s * y, 6)))
        for s in (-1, 1)
    )


def _action(bodies: tuple[Body, ...], tool: Tool, rng: np.random.Generator) -> Action:
    length = float(bodies[0].parameters["length"])
    shift = abs(bodies[0].position[1])
    both = rng.random() < SHARE_BOTH
    reach = 0.40 * length - shift if both else 0.42 * length + shift
    return sample_action(tool, rng, reach=(0.006, reach), yaw=np.radians(25), opening=0.020)
