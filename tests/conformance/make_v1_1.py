"""Writes the stored datasets of format 1.1. Run ONCE, when the format stands; never again.

    python -m tests.conformance.make_v1_1

- `cubes`: as in format 1.0 (`make_v1.py`), written by the writer of 1.1.
- `migrated`: the stored `cubes` of format 1.0, brought forward by `migrate`.

What 1.1 adds is counted here in cubes, by whole numbers. A cube's particle touches the table or a
finger within 0.75 cubes. The table: the lowest layer of cubes. The fingers are boxes of 5 x 5 x 25
cubes whose faces stand 25, 13 and 1 cubes from the middle: only in the last frame is dough there,
in 6 of its rows along y (centres up to 2.5 from the middle; those at 3.5 are 1.0 away).
"""

import json
import shutil
from pathlib import Path
from typing import Any

from doughdata.dataset.migrate import migrate
from tests.conformance.make_v1 import CUBES, make_cubes

ROOT = Path(__file__).parent / "v1.1"
RING: dict[str, Any] = {
    # 8 * 8 - 4 * 4 cubes lie on the table; each cut heaps up the 2 * 2 columns it went through.
    "table_contacts": [48, 44, 40],
    # Beside each finger: 6 rows of 2 columns and 2 rows of a third, 3 cubes high, and the heap's 2
    # columns of 3 cubes that lie in those rows: 3 * (6 * 2 + 2) + 2 * 3.
    "finger_contacts": [[0, 0], [0, 0], [48, 48]],
    "touching_components": [0, 0, 0],
    "self_contact": [False, False, False],
}
BARS: dict[str, Any] = {
    "table_contacts": [80, 80, 80],  # 2 bars of 4 * 10 cubes
    # 6 rows of 4 columns, 3 cubes high: the first column lies half a cube before the finger's face.
    "finger_contacts": [[0, 0], [0, 0], [72, 72]],
    "touching_components": [0, 1, 0],
    "self_contact": [False, False, False],
}
EXPECTED: dict[str, Any] = {
    **CUBES,
    "schema_version": "1.1",
    "scenes": {"0": {**CUBES["scenes"]["0"], **RING}, "1": {**CUBES["scenes"]["1"], **BARS}},
}


def make_migrated(path: Path) -> None:
    """A copy of the stored dataset of format 1.0, migrated."""
    shutil.copytree(ROOT.parent / "v1/cubes/dataset", path)
    migrate(path)


def make(root: Path) -> None:
    """Write both datasets and their `expected.json` into an empty folder."""
    for name, function in (("cubes", make_cubes), ("migrated", make_migrated)):
        function(root / name / "dataset")
        (root / name / "expected.json").write_text(json.dumps(EXPECTED, indent=1) + "\n")


if __name__ == "__main__":
    if (ROOT / "cubes").exists():
        raise SystemExit(f"{ROOT} is frozen: a new version gets a folder of its own")
    try:
        make(ROOT)
    except BaseException:
        for folder in ("cubes", "migrated"):
            shutil.rmtree(ROOT / folder, ignore_errors=True)
        raise
