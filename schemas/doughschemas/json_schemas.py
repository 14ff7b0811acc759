"""The JSON schemas of the format, shipped with the package."""

import json
from importlib.resources import files
from typing import Any

from doughschemas.errors import UnknownNameError

__all__ = ["JSON_SCHEMAS", "read_json_schema"]

JSON_SCHEMAS = ("commit", "info", "origin", "plan", "scene", "supplement")


def read_json_schema(name: str) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a document of format 1.x.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in JSON_SCHEMAS:
        raise UnknownNameError("JSON schema", name, JSON_SCHEMAS)
    return json.loads((files("doughschemas") / "v1" / f"{name}.json").read_text())
