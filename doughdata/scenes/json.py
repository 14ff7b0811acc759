"""Scenes as plain JSON: what `doughdata scenes show` prints and `--scenes FILE.json` reads."""

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, fields, replace
from pathlib import Path
from typing import Any

from doughdata.scenes.limits import check_scene
from doughdata.scenes.materials import material_preset
from doughdata.scenes.tools import tool_preset
from doughschemas import (
    Action,
    Body,
    Material,
    Scene,
    SceneError,
    Tool,
    UnknownNameError,
)

__all__ = ["read_scenes", "scene_from_json", "scene_to_json"]

SCENE_VERSION = "1.0"  # of the format in which scenes last changed: their text is hashed in plans


def scene_to_json(scene: Scene) -> dict[str, Any]:
    """Plain dictionary of a scene; `scene_from_json` brings it back equal."""
    return {"schema_version": SCENE_VERSION, **_plain(asdict(scene))}


def scene_from_json(
    data: Mapping[str, Any],
    *,
    name: str = "scene",
    locate: Callable[[str], str] = str,
    stored: bool = False,
) -> Scene:
    """Build a scene from JSON; a tool or the material may be the name of a preset.

    `locate` says where a mesh file that the scene names lies on this machine. The physical limits
    of a `stored` scene were checked before it was made.

    Raises:
        SceneError: unknown or missing fields, wrong types, or outside physical limits.
    """
    if not isinstance(data, Mapping):
        raise SceneError(f"{name}: a scene must be a JSON object, got {type(data).__name__}")
    version = str(data.get("schema_version", SCENE_VERSION))
    if version.partition(".")[0] != SCENE_VERSION.partition(".")[0]:
        raise SceneError(f"{name}: schema_version must be {SCENE_VERSION}, got {version!r}")
    given = {key: value for key, value in data.items() if key != "schema_version"}
    given.setdefault("scene_id", name)
    given.setdefault("family", "custom")
    if "family" not in data:
        given.setdefault("region", "custom")
    parts: dict[str, Any] = {}
    for key, make in (("bodies", Body), ("tools", Tool), ("actions", Action)):
        entries = given.pop(key, ())
        if not isinstance(entries, list | tuple):
            raise SceneError(f"{name}: {key} must be a list, got {type(entries).__name__}")
        parts[key] = tuple(
            _named(tool_preset, entry, f"{name}: {key}[{number}]")
            if make is Tool and isinstance(entry, str)
            else _build(make, entry, f"{name}: {key}[{number}]")
            for number, entry in enumerate(entries)
        )
    material = given.pop("material", {})
    parts["material"] = (
        _named(material_preset, material, f"{name}: material")
        if isinstance(material, str)
        else _build(Material, material, f"{name}: material")
    )
    scene = _located(_build(Scene, {**given, **parts}, name), locate)
    return scene if stored else check_scene(scene)


def read_scenes(path: str | Path) -> list[Scene]:
    """One scene or a list of scenes from a JSON file; mesh files may lie beside it.

    Raises:
        SceneError: the file is missing, no JSON, or holds a scene that cannot be used.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise SceneError(f"scene file {path} not found") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SceneError(f"scene file {path} is not JSON: {error}") from error
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise SceneError(f"scene file {path} holds no scene")

    def locate(file: str) -> str:
        beside = path.parent / file
        return str(beside) if beside.is_file() else file

    names = [path.stem if len(entries) == 1 else f"{path.stem}-{k}" for k in range(len(entries))]
    scenes = [
        scene_from_json(entry, name=name, locate=locate)
        for entry, name in zip(entries, names, strict=True)
    ]
    ids = [scene.scene_id for scene in scenes]
    doubles = sorted({i for i in ids if ids.count(i) > 1})
    if doubles:
        raise SceneError(f"scene file {path}: scene_id {', '.join(doubles)} occurs more than once")
    return scenes


def _located(scene: Scene, locate: Callable[[str], str]) -> Scene:
    tools = tuple(
        tool if tool.mesh is None else replace(tool, mesh=locate(tool.mesh)) for tool in scene.tools
    )
    bodies = tuple(
        replace(body, parameters={**body.parameters, "file": locate(file)})
        if body.shape == "mesh" and isinstance(file := body.parameters.get("file"), str)
        else body
        for body in scene.bodies
    )
    return replace(scene, tools=tools, bodies=bodies)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value


def _named(preset: Callable[[str], Any], name: str, where: str) -> Any:
    try:
        return preset(name)
    except UnknownNameError as error:
        raise SceneError(f"{where}: {error}") from error


def _build(make: Any, data: Any, where: str) -> Any:
    if not isinstance(data, Mapping):
        raise SceneError(f"{where} must be a JSON object, got {type(data).__name__}")
    known = {f.name: f for f in fields(make)}
    unknown = sorted(set(data) - set(known))
    if unknown:
        raise SceneError(f"{where}: unknown field {', '.join(unknown)} (known: {', '.join(known)})")
    missing = [
        n
        for n, f in known.items()
        if n not in data and f.default is MISSING and f.default_factory is MISSING
    ]
    if missing:
        raise SceneError(f"{where}: missing field {', '.join(missing)}")
    return make(**{key: _typed(known[key], value, f"{where}.{key}") for key, value in data.items()})


def _typed(field: Any, value: Any, where: str) -> Any:
    """Check a JSON value against the type its record declares; ints become floats."""
    kind = field.type if isinstance(field.type, type) else str(field.type)
    if kind is float:
        return _number(value, where)
    if kind == tuple[float, float] or str(kind) == "tuple[float, float]":
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise SceneError(f"{where} must be two numbers, got {value!r}")
        return tuple(_number(part, where) for part in value)
    if str(kind) == "str | None" and not isinstance(value, str | None):
        raise SceneError(f"{where} must be text or null, got {value!r}")
    if kind in (int, str, bool) and type(value) is not kind:
        raise SceneError(f"{where} must be {getattr(kind, '__name__', kind)}, got {value!r}")
    if field.name == "parameters":
        return _parameters(value, where)
    return value


def _number(value: Any, where: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # Every sensible quantity is far below; an integer of 400 digits would be no float at all.
    if not number or not -1e12 < value < 1e12:
        raise SceneError(f"{where} must be float and finite, got {value!r}")
    return float(value)


def _parameters(value: Any, where: str) -> dict[str, Any]:
    """A shape's own fields; the shape checks their names and ranges."""
    if not isinstance(value, Mapping):
        raise SceneError(f"{where} must be a JSON object, got {type(value).__name__}")
    for key, entry in value.items():
        if not isinstance(entry, str):
            _number(entry, f"{where}.{key}")
    return dict(value)
