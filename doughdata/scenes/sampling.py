"""What the sampled families share: tools, in-plane poses, final openings, clearances."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from doughdata.scenes.limits import check_scene
from doughdata.scenes.regions import sample_region, sample_scale
from doughdata.scenes.tools import PRESETS
from doughdata.seeds import seed_sequence
from doughschemas import Action, Body, Scene, SceneError, Tool

__all__ = ["Draft", "between", "sample_action", "sample_scene", "sample_tool"]

# Finger width [m] at tool scale 0 and 1: from a 3 mm blade to a 100 mm vise.
TOOL_WIDTHS = {"narrow": (0.003, 0.0045), "regular": (0.007, 0.014), "wide": (0.060, 0.100)}
CUTTER_DEPTH = 0.050  # [m]; two rolls of the largest size lie within 46 mm of their middle
# Half of the scenes lie on a floured table on which dough slides, half on a bare one that holds it
# (the authors' value). On the first, fingers push pieces together; on the second they cut them.
# At 0.2 a pinched ring becomes a figure eight for any jitter of its particles; at 0.5 it stands on
# a knife's edge between that and being sliced.
FLOURED, BARE = 0.2, 8.0
VISE = 0.030  # [m]; fingers wider than this cannot cut
CUTS = 0.5  # share of the final openings of blades and fingers that are meant to cut
# Fingers hold for a sixth of the time that they took to close, so that the result is there at key
# frame 64 of 75 and lasts: the last training frame is 65.
HOLD = 1 / 6
ATTEMPTS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """What is drawn before the action, which may depend on it."""

    bodies: tuple[Body, ...]
    tool: Tool
    table_friction: float

    @property
    def bare(self) -> bool:
        """Whether the table holds the dough."""
        return self.table_friction == BARE

    @property
    def cutter(self) -> bool:
        """Whether the fingers are narrow enough to cut."""
        return self.tool.width <= VISE


def between(low: float, high: float, u: float) -> float:
    """Linear map of u in [0, 1] to [low, high], rounded to a micrometre."""
    return round(float(low + (high - low) * u), 6)


def sample_tool(scale: float, rng: np.random.Generator) -> Tool:
    """One of the presets with equal chance, its width set by the tool scale.

    Blades and fingers are deeper than the presets, so that they pass right through the dough: what
    is left standing behind a finger joins the halves of a cut.
    """
    preset = PRESETS[str(rng.choice(list(PRESETS)))]
    tool = replace(preset, width=between(*TOOL_WIDTHS[preset.name], scale))
    return tool if tool.width > VISE else replace(tool, depth=CUTTER_DEPTH)


def sample_action(
    tool: Tool,
    rng: np.random.Generator,
    *,
    reach: tuple[float, float],
    yaw: float,
    opening: float,
    cuts: float = CUTS,
) -> Action:
    """A squeeze from 100 mm at an in-plane pose within `reach` [m] and `yaw` [rad].

    The share `cuts` of the final openings of blades and fingers lies within 0.5-1 mm, the rest
    between 2 mm and `opening` [m]: dough that is squeezed to 1.5 mm and more mostly holds together.
    A vise leaves at least 8 mm: under it dough, which cannot escape, would be compressed by some
    per cent.
    """
    if tool.width > VISE:
        end = rng.uniform(0.008, opening)
    elif rng.random() < cuts:
        end = rng.uniform(0.0005, 0.001)
    else:
        end = rng.uniform(0.002, opening)
    return Action(
        position=(
            between(-reach[0], reach[0], rng.random()),
            between(-reach[1], reach[1], rng.random()),
        ),
        yaw=between(-yaw, yaw, rng.random()),
        opening_end=round(float(end), 6),
    )


def sample_scene(
    family: str,
    *,
    seed: int,
    number: int,
    split: str,
    bodies: Callable[[float, np.random.Generator], tuple[Body, ...]],
    action: Callable[[Draft, np.random.Generator], Action],
    label: str | None = None,
) -> Scene:
    """Draw region, scales, bodies, tool, table, action; poses that start inside a body are redrawn.

    The scene_id is `<label>-<split>-s<seed>-<number>`; the label is the family's name by default.
    """
    rng = np.random.default_rng(seed_sequence(seed, family, split, number, "scene"))
    region = sample_region(split, rng)
    made = bodies(sample_scale(region, rng), rng)
    tool = sample_tool(sample_scale(region, rng), rng)
    draft = Draft(bodies=made, tool=tool, table_friction=float(rng.choice((FLOURED, BARE))))
    for _ in range(ATTEMPTS):
        scene = Scene(
            scene_id=f"{label or family}-{split}-s{seed}-{number:06d}",
            family=family,
            seed=seed,
            split=split,
            region=region,
            bodies=made,
            tools=(tool,),
            actions=(_held(action(draft, rng)),),
            table_friction=draft.table_friction,
        )
        try:
            return check_scene(scene)
        except SceneError as error:
            if "finger starts inside" not in str(error):
                raise
    raise SceneError(
        f"family {family!r}: no free pose in {ATTEMPTS} attempts (seed {seed}, {number})"
    )


def _held(action: Action) -> Action:
    return replace(action, hold=round(HOLD * action.duration, 6))
