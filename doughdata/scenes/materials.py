"""Materials: named presets and ranges to draw from.

The model is elastic up to a von Mises yield stress and then flows without hardening. Real doughs
are viscoelastic: their stiffness depends on the rate and there is no single yield point. The
presets are therefore round numbers of the right order, in the right order to each other, chosen so
that a piece of 30 mm height stands (density x gravity x height is 350-500 Pa, well below yield) and
fingers of some newtons squeeze it.

- `play-doh`: the default of the format. Flour, salt and water. The yield stress is the one at which
  a 3 mm blade cuts a roll and a 10 mm finger squeezes it apart, as they do on the table.
- `dough`: bread dough. It is a critical gel: its relaxation modulus falls with a power of time
  (Ng, McKinley and Padmanabhan 2006, "Linear to non-linear rheology of wheat flour dough"), so a
  modulus is one of a time scale. With G' of 10 kPa, usual near 1 Hz, E = 3 G' is 30 kPa. It is
  wetter than play-doh, so lighter, nearer to incompressible and softer; its yield strain is the
  same 4 %. Blades tend to pinch it, where they cut play-doh.
- `clay`: soft oil-based modelling clay. Mineral-filled, so heavy, and the stiffest of the three.
  Cold plasticine is stiffer still, beyond what fingers of a small gripper deform; it softens
  strongly with temperature (Mechanics of Materials 41, 2009, on plasticine as a model of glass).

Published sets for one and the same material differ by an order of magnitude with the protocol; who
needs the numbers of a real batch identifies them from an interaction (arXiv:2411.00554) and writes
them into the scene.
"""

import numpy as np

from doughschemas import Material, UnknownNameError

__all__ = ["MATERIALS", "SAMPLED", "material_preset", "sample_material"]

SAMPLED = "sampled"  # stands for a material of its own in every scene
MATERIALS = {
    "play-doh": Material(),
    "dough": Material(young_modulus=30e3, poisson_ratio=0.45, density=1200.0, yield_stress=1.2e3),
    "clay": Material(young_modulus=200e3, poisson_ratio=0.4, density=1700.0, yield_stress=8e3),
}
# What `sample_material` draws from: a little beyond the presets on both sides.
YOUNG_MODULUS = (25e3, 220e3)  # [Pa], logarithmic
YIELD_STRAIN = (0.03, 0.05)  # yield stress over Young's modulus
POISSON_RATIO = (0.35, 0.45)
DENSITY = (1100.0, 1800.0)  # [kg/m3]


def material_preset(name: str) -> Material:
    """A named material.

    Raises:
        UnknownNameError: no such preset.
    """
    if name not in MATERIALS:
        raise UnknownNameError("material", name, MATERIALS)
    return MATERIALS[name]


def sample_material(rng: np.random.Generator) -> Material:
    """A material within the stated ranges; stiff materials yield late, as real ones do."""
    low, high = np.log(YOUNG_MODULUS)
    modulus = float(np.exp(rng.uniform(low, high)))
    return Material(
        young_modulus=round(modulus, 1),
        poisson_ratio=round(float(rng.uniform(*POISSON_RATIO)), 4),
        density=round(float(rng.uniform(*DENSITY)), 2),
        yield_stress=round(modulus * float(rng.uniform(*YIELD_STRAIN)), 1),
    )
