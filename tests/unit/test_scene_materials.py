"""Materials: presets, ranges, scenes made of another one."""

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from doughcli.build import sample_one, wanted_scenes
from doughdata.requests import FamilyScenes
from doughdata.scenes import (
    MATERIALS,
    FamilyName,
    load_family,
    sample_material,
    scene_from_json,
    scene_to_json,
)
from doughdata.scenes.materials import DENSITY, POISSON_RATIO, YIELD_STRAIN, YOUNG_MODULUS
from doughdata.sim.mpm import MpmConfig, MpmSimulator
from doughschemas import Action, BadInputError, Body, Material, Scene, SceneError, UnknownNameError

SMALL = {"bodies": [{"shape": "ball"}], "tools": ["regular"], "actions": [{}]}


@pytest.mark.parametrize("name", MATERIALS)
def test_a_material_may_be_named_in_json(name: str) -> None:
    """A preset's name gives its numbers, which are what a stored scene holds."""
    scene = scene_from_json({**SMALL, "material": name})
    assert scene.material == MATERIALS[name]
    assert scene_to_json(scene)["material"] == asdict(MATERIALS[name])


def test_an_unknown_material_is_refused_where_it_stands() -> None:
    """The message names the field and the known presets."""
    with pytest.raises(SceneError, match=r"material: unknown material 'butter'.*clay, dough"):
        scene_from_json({**SMALL, "material": "butter"})


def test_sampled_materials_lie_in_the_stated_ranges_and_fill_them() -> None:
    """Every draw is inside the ranges, and 200 draws cover 80 % of each."""
    rng = np.random.default_rng(3)
    drawn = [sample_material(rng) for _ in range(200)]
    for (low, high), values in (
        (np.log(YOUNG_MODULUS), [math.log(m.young_modulus) for m in drawn]),
        (POISSON_RATIO, [m.poisson_ratio for m in drawn]),
        (DENSITY, [m.density for m in drawn]),
        (YIELD_STRAIN, [m.yield_stress / m.young_modulus for m in drawn]),
    ):
        assert low - 1e-3 <= min(values)
        assert max(values) <= high + 1e-3
        assert max(values) - min(values) > 0.8 * (high - low)


def test_another_material_is_another_scene_of_the_same_form() -> None:
    """Bodies and actions stay, scene_id and recorded source differ for every material."""
    own = load_family("rolls").sample(seed=4, number=2, split="train")
    ids, sources = {own.scene_id}, {FamilyScenes(family="rolls", count=1).source}
    for material in (*MATERIALS, "sampled"):
        wanted = FamilyScenes(family="rolls", count=1, material=material)
        scene = load_family(wanted.source).sample(seed=4, number=2, split="train")
        assert (scene.bodies, scene.actions) == (own.bodies, own.actions)
        ids.add(scene.scene_id)
        sources.add(wanted.source)
    assert len(ids) == len(sources) == len(MATERIALS) + 2


def test_each_sampled_scene_has_a_material_of_its_own() -> None:
    """Numbers draw different materials, the same number the same one."""
    family = load_family("doughnut?sampled")
    drawn = [family.sample(seed=0, number=k, split="train").material for k in range(8)]
    assert len({m.young_modulus for m in drawn}) == 8
    assert family.sample(seed=0, number=3, split="train").material == drawn[3]


@pytest.mark.parametrize("text", ["rolls", "mesh:a b/c.stl", "rolls?clay", "mesh:C:x.obj?dough"])
def test_a_family_name_comes_back_from_its_text(text: str) -> None:
    """Reading and writing the text form of a family are inverse."""
    assert str(FamilyName.parse(text)) == text


@pytest.mark.parametrize("text", ["", ":", "rolls:", "rolls?", "?clay", ":x.stl"])
def test_a_broken_family_name_is_refused(text: str) -> None:
    """A missing name, argument or material is no family."""
    with pytest.raises(BadInputError, match="NAME"):
        FamilyName.parse(text)


def test_wrong_families_and_materials_are_named() -> None:
    """Unknown names list the known ones; a file for a family without files is refused."""
    with pytest.raises(UnknownNameError, match="unknown material 'clai'; did you mean 'clay'"):
        load_family("rolls?clai")
    with pytest.raises(UnknownNameError, match="unknown scene family 'role'"):
        load_family("role")
    with pytest.raises(BadInputError, match="takes no argument"):
        load_family("rolls:x.stl")


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_stands_and_is_squeezed_to_the_opening(name: str) -> None:
    """A ball keeps more than 80 % of its height at rest; then dough fills the gap and no more.

    Vises 12 mm apart leave particle centres within the gap, up to one grid cell of contact.
    """
    scene = Scene(
        scene_id="x",
        family="custom",
        bodies=(Body(shape="ball", parameters={"radius": 0.010}),),
        material=MATERIALS[name],
        tools=(scene_from_json({**SMALL, "tools": ["wide"]}).tools[0],),
        actions=(Action(opening_start=0.030, opening_end=0.012, speed=0.1),),
    )
    config = MpmConfig(spacing=0.0025, frames=2, settle=0.2)
    positions = MpmSimulator(config).simulate(scene, rng=np.random.default_rng(0)).positions
    assert np.ptp(positions[0][:, 2]) > 0.8 * (0.020 - config.spacing)
    assert np.abs(positions[1][:, 0]).max() < 0.006 + config.cells * config.spacing
    assert np.ptp(positions[1][:, 1]) > np.ptp(positions[0][:, 1])


def test_the_default_is_play_doh() -> None:
    """The preset is what a scene without a material is made of."""
    assert MATERIALS["play-doh"] == Material() == scene_from_json(SMALL).material


def test_the_command_line_asks_for_families_in_a_material(tmp_path: Path) -> None:
    """`--material` reaches every family; scenes from a file have their own and refuse it."""
    wanted = wanted_scenes("rolls,ball", count=3, seed=1, split="test", material="clay")
    assert [entry.source for entry in wanted] == ["rolls?clay", "ball?clay"]
    assert all(sample_one(entry, split="test").material == MATERIALS["clay"] for entry in wanted)
    (tmp_path / "mine.json").write_text(json.dumps(SMALL))
    with pytest.raises(BadInputError, match="names its own material"):
        wanted_scenes(str(tmp_path / "mine.json"), count=1, seed=0, split="train", material="clay")
    with pytest.raises(BadInputError, match="needs a file: mesh:FILE"):
        wanted_scenes("mesh", count=1, seed=0, split="train")
