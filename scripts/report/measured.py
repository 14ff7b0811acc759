"""Measurements that are not made twice: each is a command and the JSON that it printed."""

import hashlib
import json
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from doughnet.weights import write_atomically

__all__ = ["Measurements"]


class Measurements:
    """A folder with one file a measurement, which holds for the inputs that it was made of."""

    def __init__(self, folder: Path, *, inputs: Sequence[str]) -> None:
        """`inputs` name what all commands read: a change of them makes everything new."""
        self.folder, self.inputs = folder, list(inputs)
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, name: str, command: Sequence[str]) -> dict[str, Any]:
        """What a command prints, or what it printed before for the same inputs.

        Returns:
            `command`; `seconds`; and `result`, or `error`, the line that it ended with.
        """
        path = self.folder / f"{name}.json"
        key = hashlib.sha256(json.dumps([*self.inputs, *command]).encode()).hexdigest()
        if path.exists():
            known = json.loads(path.read_text(encoding="utf-8"))
            if known["key"] == key and "result" in known:
                return known
        found = {"key": key, "command": " ".join(map(_short, command)), **_run(command)}
        write_atomically(path, json.dumps(found).encode())
        return found


def _run(command: Sequence[str]) -> dict[str, Any]:
    start = time.perf_counter()
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    seconds = round(time.perf_counter() - start, 1)
    if done.returncode == 0:
        return {"seconds": seconds, "result": json.loads(done.stdout)}
    lines = done.stderr.strip().splitlines()
    return {"seconds": seconds, "error": lines[-1] if lines else f"exit code {done.returncode}"}


def _short(word: str) -> str:
    """A program goes by its name, a file by its place from here."""
    path = Path(word)
    if not path.is_absolute():
        return word
    if path.parent.name == "bin":
        return path.name
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else word
