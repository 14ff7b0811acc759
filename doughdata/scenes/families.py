"""From a family's name, as people write it, to the family: `rolls`, `mesh:FILE`, `rolls?clay`."""

from dataclasses import dataclass, replace

import numpy as np

from doughdata import registry
from doughdata.scenes.limits import check_scene
from doughdata.scenes.materials import MATERIALS, SAMPLED, material_preset, sample_material
from doughdata.seeds import seed_sequence
from doughdata.stages import SceneFamily
from doughschemas import BadInputError, Scene, UnknownNameError

__all__ = ["FamilyName", "load_family"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyName:
    """`name[:argument][?material]`: what a plan records, so that equal text means equal scenes."""

    name: str  # registered under `doughdata.scenes`
    argument: str | None = None  # handed to the family, for example a file
    material: str | None = None  # a preset or `sampled`; None = the family's own

    @classmethod
    def parse(cls, text: str) -> "FamilyName":
        """Read the text form.

        Raises:
            BadInputError: an empty name, argument or material.
        """
        rest, asks, material = text.rpartition("?") if "?" in text else (text, "", "")
        name, colon, argument = rest.partition(":")
        if not name or (colon and not argument) or (asks and not material):
            raise BadInputError(f"a scene family is NAME[:FILE][?MATERIAL], got {text!r}")
        return cls(name=name, argument=argument or None, material=material or None)

    def __str__(self) -> str:
        argument = f":{self.argument}" if self.argument else ""
        return f"{self.name}{argument}{f'?{self.material}' if self.material else ''}"


def load_family(text: str) -> SceneFamily:
    """The family that a text names.

    Raises:
        UnknownNameError: nobody registered that family or material.
        BadInputError: an argument for a family that takes none.
        MissingPackageError: the family needs an extra that is not installed.
    """
    wanted = FamilyName.parse(text)
    make = registry.load("scenes", wanted.name)
    try:
        family: SceneFamily = make() if wanted.argument is None else make(wanted.argument)
    except TypeError as error:
        raise BadInputError(
            f"scene family {wanted.name!r} takes no argument, got {wanted.argument!r}"
        ) from error
    if wanted.material is None:
        return family
    if wanted.material not in (*MATERIALS, SAMPLED):
        raise UnknownNameError("material", wanted.material, (*MATERIALS, SAMPLED))
    return _OtherMaterial(family, wanted.material)


class _OtherMaterial:
    """The scenes of a family with the same bodies and actions, made of something else."""

    def __init__(self, family: SceneFamily, material: str) -> None:
        self.family, self.material = family, material

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split; its scene_id ends in the material's name."""
        scene = self.family.sample(seed=seed, number=number, split=split)
        material = (
            sample_material(
                np.random.default_rng(seed_sequence(seed, scene.family, split, number, "material"))
            )
            if self.material == SAMPLED
            else material_preset(self.material)
        )
        return check_scene(
            replace(scene, material=material, scene_id=f"{scene.scene_id}-{self.material}")
        )
