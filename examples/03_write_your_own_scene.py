"""Write a scene as JSON: a small ring, cut on one side by a blade of your own, and run it.

Run: python examples/03_write_your_own_scene.py [FOLDER]
"""

import json
import subprocess
import sys
from pathlib import Path

import doughdata

SCENE = {
    "scene_id": "my-ring",
    "bodies": [{"shape": "ring", "parameters": {"ring_radius": 0.018, "tube_radius": 0.006}}],
    "material": {"yield_stress": 1500.0},
    "tools": [{"name": "blade", "depth": 0.012, "width": 0.004}],
    "actions": [
        {"position": [0.018, 0.0], "opening_start": 0.016, "opening_end": 0.001, "speed": 0.05}
    ],
}
COMMAND = ["generate", "--scenes", "my-ring.json", "--frames", "16", "--dataset", "mine"]


def main(folder: Path) -> None:
    """What a scene leaves out has a documented default (SPEC.md)."""
    (folder / "my-ring.json").write_text(json.dumps(SCENE, indent=2))
    doughdata_command = str(Path(sys.executable).with_name("doughdata"))
    subprocess.run([doughdata_command, *COMMAND], cwd=folder, check=True)
    ds = doughdata.open_dataset(str(folder / "mine"))
    before, after = ds.frame(scene=0, frame=0).topology, ds.frame(scene=0, frame=15).topology
    print(
        f"genus {before.genus} -> {after.genus}, components {before.num_components} -> "
        f"{after.num_components}"
    )
    assert before.genus == (1,)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
