"""Add a sensor: one class, one entry-point line, here in a package outside of doughdata.

Run: python examples/04_add_a_sensor.py DATASET
"""

import subprocess
import sys
import tempfile
from pathlib import Path

SENSOR = '''
"""A time-of-flight camera that loses what is steep and rounds to whole millimetres."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class CoarseConfig:
    step: float = 0.001  # [m], rounding
    drop: float = 0.02  # share of pixels that are lost


class Coarse:
    def __init__(self, config: CoarseConfig | None = None) -> None:
        self.config = config or CoarseConfig()

    def observe(self, image, camera, *, rng: np.random.Generator):
        depth = np.round(image.depth / self.config.step) * self.config.step
        lost = rng.random(depth.shape) < self.config.drop
        return np.where(lost, 0.0, depth).astype(np.float32)
'''
PROJECT = """
[project]
name = "coarse-sensor"
version = "1.0"

[project.entry-points."doughdata.sensors"]
coarse = "coarse_sensor:Coarse"

[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
"""


def main(dataset: str) -> None:
    """Install the package into a folder of its own and render with `--noise coarse`."""
    with tempfile.TemporaryDirectory() as folder:
        root, site = Path(folder, "coarse"), Path(folder, "site")
        root.mkdir()
        (root / "coarse_sensor.py").write_text(SENSOR)
        (root / "pyproject.toml").write_text(PROJECT)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-qq"]
        options = ["--no-deps", "--no-build-isolation", "--target", str(site)]
        subprocess.run([*pip, *options, str(root)], check=True)
        doughdata_command = str(Path(sys.executable).with_name("doughdata"))
        subprocess.run(
            [doughdata_command, "render", "--noise", "coarse", "--dataset", dataset],
            check=True,
            env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(site)},
        )


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "dough-dataset")
