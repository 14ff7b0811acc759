"""Scenes as plain JSON: what `doughdata scenes show` prints and `--scenes FILE.json` reads."""

import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from doughdata.scenes.limits import check_scene
from doughdata.scenes.tools import tool_preset
from doughschemas import SCHEMA_VERSION, Action, Body, Material, Scene, SceneError, Tool

__all__ = ["read_scenes", "scene_from_json", "scene_to_json"]


def scene_to_json(scene: Scene) -> dict[str, Any]:
    """Plain dictionary of a scene; `scene_from_json` brings it back equal."""
    return {"schema_version": SCHEMA_VERSION, **_plain(asdict(scene))}


def scene_from_json(data: Mapping[str, Any], *, name: str = "scene") -> Scene:
    """Build a scene from JSON; a tool may be the name of a preset.

    Raises:
        SceneError: unknown or missing fields, wrong types, or outside physical limits.
    """
    if not isinstance(data, Mapping):
        raise SceneError(f"{name}: a scene must be a JSON object, got {type(data).__name__}")
    version = str(data.get("schema_version", SCHEMA_VERSION))
    if version.partition(".")[0] != SCHEMA_VERSION.partition(".")[0]:
        raise SceneError(f"{name}: schema_version must be {SCHEMA_VERSION}, got {version!r}")
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
            tool_preset(entry)
            if make is Tool and isinstance(entry, str)
            else _build(make, entry, f"{name}: {key}[{number}]")
            for number, entry in enumerate(entries)
        )
    material = _build(Material, given.pop("material", {}), f"{name}: material")
    return check_scene(_build(Scene, {**given, **parts, "material": material}, name))


def read_scenes(path: str | Path) -> list[Scene]:
    """One scene or a list of scenes from a JSON file.

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
    scenes = [
        scene_from_json(entry, name=path.stem if len(entries) == 1 else f"{path.stem}-{number}")
        for number, entry in enumerate(entries)
    ]
    ids = [scene.scene_id for scene in scenes]
    doubles = sorted({i for i in ids if ids.count(i) > 1})
    if doubles:
        raise SceneError(f"scene file {path}: scene_id {', '.join(doubles)} occurs more than once")
    return scenes


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value


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
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and number:
        return float(value)
    if kind == tuple[float, float] or str(kind) == "tuple[float, float]":
        if isinstance(value, list | tuple) and len(value) == 2:
            return (float(value[0]), float(value[1]))
        raise SceneError(f"{where} must be two numbers, got {value!r}")
    wrong = (kind is float) or (kind in (int, str, bool) and type(value) is not kind)
    if wrong:
        name = getattr(kind, "__name__", str(kind))
        raise SceneError(f"{where} must be {name}, got {value!r}")
    return value
