"""JSON documents under `meta/`: one canonical form, and a checksum inside each."""

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from doughschemas import DamagedDatasetError

__all__ = ["dump_document", "load_document", "plain_json"]


def plain_json(value: Any) -> Any:
    """The value as JSON has it: tuples become lists, keys become strings."""
    return json.loads(json.dumps(value))


def checksum_of(document: Mapping[str, Any]) -> str:
    """sha256 of the canonical text (sorted keys, no spaces, ASCII) without `checksum` itself."""
    bare = {key: value for key, value in document.items() if key != "checksum"}
    return sha256(json.dumps(bare, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def dump_document(document: Mapping[str, Any]) -> bytes:
    """Bytes of a document, its checksum added."""
    bare = plain_json({key: value for key, value in document.items() if key != "checksum"})
    return (json.dumps({**bare, "checksum": checksum_of(bare)}, indent=1) + "\n").encode()


def load_document(data: bytes, *, name: str) -> dict[str, Any]:
    """Parse a document.

    Raises:
        DamagedDatasetError: it is no JSON object, or its checksum does not fit.
    """
    try:
        document = json.loads(data)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DamagedDatasetError(f"{name}: not JSON ({error})") from error
    if not isinstance(document, dict) or document.get("checksum") != checksum_of(document):
        raise DamagedDatasetError(f"{name}: the document does not fit its checksum")
    return document
