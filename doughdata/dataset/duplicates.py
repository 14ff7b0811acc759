"""Which scenes are near-duplicates, so that none of them is trained on and tested on at once."""

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from hashlib import sha256
from typing import Any

import pyarrow as pa

__all__ = ["duplicate_groups", "leaking_groups", "near_duplicate_key"]

DIGITS = 6  # lengths and angles are the same to a micrometre and a microradian
BODY = ("shape", "parameters", "position", "yaw")
TOOL = ("depth", "width", "height", "mesh", "scale")
ACTION = ("tool", "position", "yaw", "opening_start", "opening_end")


def near_duplicate_key(scene: Mapping[str, Any]) -> str:
    """Hex digest that two scenes share if they squeeze the same bodies in the same way.

    Names, seeds, families, materials, friction, speeds and holds do not count: a roll of clay that
    is cut like a roll of dough shows the same shapes.

    Args:
        scene: plain JSON as in `v1/scene.json` and in the column `parameters` of the scenes. Other
            JSON, such as a recording has, is a near-duplicate of nothing but itself.
    """
    if not {"bodies", "tools", "actions"} <= set(scene):
        return sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest()
    parts = {
        "bodies": [{name: body.get(name) for name in BODY} for body in scene["bodies"]],
        "tools": [{name: tool.get(name) for name in TOOL} for tool in scene["tools"]],
        "actions": [{name: action.get(name) for name in ACTION} for action in scene["actions"]],
    }
    return sha256(json.dumps(_rounded(parts), sort_keys=True).encode()).hexdigest()


def duplicate_groups(scenes: pa.Table) -> dict[str, list[int]]:
    """Key -> rows of the table of scenes that share it, both in the order of the table."""
    groups: dict[str, list[int]] = defaultdict(list)
    for row, text in enumerate(scenes["parameters"].to_pylist()):
        groups[near_duplicate_key(json.loads(text))].append(row)
    return dict(groups)


def leaking_groups(scenes: Iterable[pa.Table]) -> list[dict[str, str]]:
    """Groups of near-duplicates that lie in more than one split: scene_id -> split."""
    found: dict[str, dict[str, str]] = defaultdict(dict)
    for table in scenes:
        ids, splits = table["scene_id"].to_pylist(), table["split"].to_pylist()
        for key, rows in duplicate_groups(table).items():
            found[key].update({ids[row]: splits[row] for row in rows})
    return [group for group in found.values() if len(set(group.values())) > 1]


def _rounded(value: Any) -> Any:
    """The value with every number rounded; whole numbers, floats and -0.0 become one form."""
    if isinstance(value, Mapping):
        return {name: _rounded(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(part) for part in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return round(float(value), DIGITS) + 0.0
    return value
