"""How a preset is trained: the paper's way, and its ablations, each with one decision changed."""

from collections.abc import Mapping
from dataclasses import dataclass

from doughschemas import UnknownNameError

__all__ = ["RECIPES", "Recipe", "recipe"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """What differs from one training to another; the paper's choices by default."""

    steps: int = 2  # predictions of a dynamics sample, each from the one before
    explicit: bool = False  # compare decoded shapes instead of latents
    relative: bool = False  # predict the change of the latents
    complete: bool = False  # see points all over the true surfaces instead of a view


RECIPES: Mapping[str, Recipe] = {
    "full": Recipe(),
    "one-step": Recipe(steps=1),
    "explicit": Recipe(explicit=True),
    "relative": Recipe(relative=True),
    "complete": Recipe(complete=True),
}


def recipe(name: str) -> Recipe:
    """The recipe of a name.

    Raises:
        UnknownNameError: no such recipe; the message lists the known ones.
    """
    if name not in RECIPES:
        raise UnknownNameError("recipe", name, RECIPES)
    return RECIPES[name]
