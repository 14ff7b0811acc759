"""From option values to objects: the one place where names on the command line become parts."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from doughdata import registry
from doughdata.requests import FamilyScenes, Stages
from doughschemas import BadInputError, MissingPackageError, Scene, UnknownNameError

__all__ = ["build_executor", "build_sensors", "build_stages", "wanted_scenes"]

STAGE_NAMES = ("simulate", "topology", "mesh")
PRESETS = ("draft", "standard", "fine")
ARCHS = ("auto", "cpu", "cuda", "vulkan")
SPLITS = ("train", "test")


def build_stages(
    names: tuple[str, ...], *, preset: str, frames: int, arch: str, mesher: str
) -> Stages:
    """The stages of `generate`.

    Raises:
        UnknownNameError: an unknown stage, preset, arch or mesher.
    """
    for kind, name, known in (
        *(("stage", name, STAGE_NAMES) for name in names),
        ("preset", preset, PRESETS),
        ("arch", arch, ARCHS),
    ):
        if name not in known:
            raise UnknownNameError(kind, name, known)
    if not names:
        raise BadInputError(f"--stages needs at least one of {', '.join(STAGE_NAMES)}")
    make_mesher = registry.load("meshers", mesher)
    return Stages(
        simulator=_simulator(preset, frames, arch) if "simulate" in names else None,
        check=_check() if "topology" in names else None,
        mesher=make_mesher() if "mesh" in names else None,
    )


def _simulator(preset: str, frames: int, arch: str) -> Any:
    make = registry.load("simulators", "mpm")
    from doughdata.sim import mpm

    return make(replace(getattr(mpm, preset)(), frames=frames, arch=arch))


def _check() -> Any:
    make = registry.load("topology", "dynamic")
    from doughdata.sim.pull import MpmPullApart

    return make(pull_apart=MpmPullApart())


def build_sensors(names: tuple[str, ...]) -> dict[str, Any]:
    """Sensor name -> sensor.

    Raises:
        UnknownNameError: a name that nobody registered.
        MissingPackageError: nothing can be rendered, because Open3D is not installed.
    """
    if names and find_spec("open3d") is None:
        raise MissingPackageError("open3d", "render")
    return {name: registry.load("sensors", name)() for name in names}


def build_executor(name: str, workers: int | None, *, items: int) -> Any:
    """An executor; a single item or worker needs no processes.

    Raises:
        UnknownNameError: a name that nobody registered.
    """
    make = registry.load("executors", name)
    if name == "processes" and (workers == 1 or items <= 1):
        make = registry.load("executors", "serial")
    return make() if workers is None else make(workers=workers)


def wanted_scenes(
    text: str, *, count: int, seed: int, split: str, material: str | None = None
) -> list[FamilyScenes | Scene]:
    """Families by name (`mesh:FILE` with a file), or the scenes of a JSON file.

    Raises:
        UnknownNameError: an unknown family, split or material.
        SceneError: a file that cannot be used.
        BadInputError: no family, or a material for scenes that have their own.
    """
    if split not in SPLITS:
        raise UnknownNameError("split", split, SPLITS)
    if text.endswith(".json") or Path(text).is_file():
        from doughdata.scenes import read_scenes

        if material is not None:
            raise BadInputError(f"--material is for scene families; {text} names its own material")
        return list(read_scenes(text))
    families = [part.strip() for part in text.split(",") if part.strip()]
    if not families:
        raise BadInputError("--scenes needs a family or a .json file")
    wanted: list[FamilyScenes | Scene] = [
        FamilyScenes(family=family, count=count, seed=seed, split=split, material=material)
        for family in dict.fromkeys(families)
    ]
    for entry in wanted:
        sample_one(entry, split=split)
    return wanted


def sample_one(entry: FamilyScenes | Scene, *, split: str, number: int = 0) -> Scene:
    """One scene of what is wanted; a name or a mesh that cannot be used is refused here.

    Raises:
        UnknownNameError: an unknown family or material.
        SceneError: a mesh that cannot be used.
    """
    if isinstance(entry, Scene):
        return entry
    from doughdata.scenes import load_family

    return load_family(entry.source).sample(seed=entry.seed, number=number, split=split)
