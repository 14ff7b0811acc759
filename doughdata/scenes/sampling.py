"""What the sampled families share: tools, in-plane poses, final openings, clearances."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from doughdata.scenes.limits import check_scene
from doughdata.scenes.regions import sample_region, sample_scale
from doughdata.scenes.tools import PRESETS
from doughdata.seeds import seed_sequence
from doughschemas import Action, Body, Scene, SceneError, Tool

__all__ = ["between", "sample_action", "sample_scene", "sample_tool"]

# Finger width [m] at tool scale 0 and 1: from a 3 mm blade to a 100 mm vise.
TOOL_WIDTHS = {"narrow": (0.003, 0.0045), "regular": (0.007, 0.014), "wide": (0.060, 0.100)}
ATTEMPTS = 200


def between(low: float, high: float, u: float) -> float:
    """Linear map of u in [0, 1] to [low, high], rounded to a micrometre."""
    return round(low + (high - low) * u, 6)


def sample_tool(scale: float, rng: np.random.Generator) -> Tool:
    """One of the presets with equal chance, its width set by the tool scale."""
    preset = PRESETS[str(rng.choice(list(PRESETS)))]
    return replace(preset, width=between(*TOOL_WIDTHS[preset.name], scale))


def sample_action(
    rng: np.random.Generator, *, reach: tuple[float, float], yaw: float, opening: float
) -> Action:
    """A squeeze from 100 mm at an in-plane pose within `reach` [m] and `yaw` [rad].

    Half of the final openings lie within 1-3 mm (cuts), half between 3 mm and `opening` [m].
    """
    deep = rng.random() < 0.5
    end = rng.uniform(0.001, 0.003) if deep else rng.uniform(0.003, opening)
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
    action: Callable[[tuple[Body, ...], np.random.Generator], Action],
) -> Scene:
    """Draw region, scales, bodies, tool and action; poses that start inside a body are redrawn."""
    rng = np.random.default_rng(seed_sequence(seed, family, split, number, "scene"))
    region = sample_region(split, rng)
    made = bodies(sample_scale(region, rng), rng)
    tool = sample_tool(sample_scale(region, rng), rng)
    for _ in range(ATTEMPTS):
        scene = Scene(
            scene_id=f"{family}-{split}-s{seed}-{number:06d}",
            family=family,
            seed=seed,
            split=split,
            region=region,
            bodies=made,
            tools=(tool,),
            actions=(action(made, rng),),
        )
        try:
            return check_scene(scene)
        except SceneError as error:
            if "finger starts inside" not in str(error):
                raise
    raise SceneError(
        f"family {family!r}: no free pose in {ATTEMPTS} attempts (seed {seed}, {number})"
    )
