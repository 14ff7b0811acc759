"""The examples and the README's Python run as they stand."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import doughdata

ROOT = Path(__file__).parents[2]


def run(example: str, *arguments: object, cwd: Path) -> str:
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / example), *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_make_and_look(tmp_path: Path) -> None:
    """Example 1 makes a dataset and a picture."""
    assert "scene 0 ends with c =" in run("01_make_and_look.py", tmp_path, cwd=tmp_path)
    assert (tmp_path / "sheet.png").stat().st_size > 10_000


def test_load_and_train(tiny_dataset: Path, tmp_path: Path) -> None:
    """Example 2 trains one step with two workers; the loss is that of an untrained network."""
    printed = run("02_load_and_train.py", tiny_dataset, cwd=tmp_path)
    assert 0.3 < float(printed.split()[-1]) < 1.5


def test_write_your_own_scene(tmp_path: Path) -> None:
    """Example 3 runs a scene written by hand."""
    assert "genus (1,) ->" in run("03_write_your_own_scene.py", tmp_path, cwd=tmp_path)


def test_add_a_sensor(tiny_dataset: Path, tmp_path: Path) -> None:
    """Example 4 adds a sensor from outside; its depth is in whole millimetres."""
    copy = shutil.copytree(tiny_dataset, tmp_path / "dough")
    run("04_add_a_sensor.py", copy, cwd=tmp_path)
    depth = doughdata.open_dataset(str(copy)).frame(scene=0, frame=5).depth("coarse")
    seen = depth.depth[0][depth.depth[0] > 0] * depth.depth_unit
    np.testing.assert_allclose(seen, np.round(seen, 3), atol=1e-9)
    assert 0.01 < (depth.depth[0] == 0).mean() < 0.2


@pytest.mark.slow
def test_cut_join_and_your_own_tool(tmp_path: Path) -> None:
    """Example 5 cuts a roll in two and joins it again, and opens a ring with a user's own wedge."""
    printed = run("05_cut_join_and_your_own_tool.py", tmp_path, cwd=tmp_path)
    assert "(0, 0)" in printed


def test_the_readme_reads_a_dataset(tiny_dataset: Path, tmp_path: Path) -> None:
    """The Python blocks of README run against a real dataset named as in the text."""
    (tmp_path / "dough-dataset").symlink_to(tiny_dataset)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 2
    code = "\n".join(blocks).replace("frame=60", "frame=5")
    script = tmp_path / "readme.py"
    script.write_text(
        f"import os\nos.chdir({str(tmp_path)!r})\nif __name__ == '__main__':\n    "
        + code.replace("\n", "\n    ")
    )
    subprocess.run([sys.executable, str(script)], check=True)
    assert "loader" in runpy.run_path(str(script), run_name="__main__")
