"""A small real dataset, made by the commands a user types."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# Short rolls and a small ring, squeezed fast: a second of simulation each.
BLADE = {"name": "blade", "depth": 0.012, "width": 0.004, "height": 0.03}


def roll(x: float) -> dict:
    return {"shape": "roll", "parameters": {"radius": 0.007, "length": 0.024}, "position": [x, 0.0]}


def squeeze(end: float, *, start: float = 0.04, speed: float = 0.1, **more: object) -> dict:
    return {"opening_start": start, "opening_end": end, "speed": speed, **more}


TINY = [
    {
        "scene_id": "two-rolls",
        "bodies": [roll(-0.008), roll(0.008)],
        "tools": ["regular"],
        "actions": [squeeze(0.010, hold=0.05)],
    },
    {
        "scene_id": "cut-roll",
        "bodies": [roll(0.0)],
        "tools": [BLADE],
        "actions": [squeeze(0.001, start=0.02)],
    },
    {
        "scene_id": "ring",
        "bodies": [{"shape": "ring", "parameters": {"ring_radius": 0.014, "tube_radius": 0.006}}],
        "tools": [{**BLADE, "width": 0.01}],
        "actions": [squeeze(0.030, start=0.05)],
    },
]
FRAMES = 8


def command(
    *arguments: object, cwd: Path, code: int | None = 0
) -> subprocess.CompletedProcess[str]:
    """Run `doughdata` as a user would and check its exit code."""
    done = subprocess.run(
        [str(Path(sys.executable).with_name("doughdata")), *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "120", "OMP_NUM_THREADS": "1"},
    )
    if code is not None:
        assert done.returncode == code, f"{arguments}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture(scope="session")
def tiny_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three short scenes as a JSON file."""
    file = tmp_path_factory.mktemp("scenes") / "tiny.json"
    file.write_text(json.dumps(TINY))
    return file


@pytest.fixture(scope="session")
def tiny_dataset(tiny_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three scenes simulated, checked, meshed and rendered. Read only: copy it to change it."""
    folder = tmp_path_factory.mktemp("tiny")
    options = ("--dataset", "dough", "--executor", "serial")
    command("generate", "--scenes", tiny_scenes, "--frames", FRAMES, *options, cwd=folder)
    command("render", "--noise", "realsense", "--noise", "none", *options, cwd=folder)
    return folder / "dough"
