"""Write a scene as JSON: a wide ring, squeezed by a blade of your own, and run it.

Run: python examples/03_write_your_own_scene.py [FOLDER]
"""

import json
import sys
from pathlib import Path

from doughdata import pipeline

SCENE = {
    "scene_id": "my-ring",
    "bodies": [{"shape": "ring", "parameters": {"ring_radius": 0.020, "tube_radius": 0.007}}],
    "material": {"yield_stress": 1500.0},
    "tools": [{"name": "blade", "depth": 0.015, "width": 0.004}],
    "actions": [{"position": [0.020, 0.0], "yaw": 0.0, "opening_start": 0.03, "opening_end": 0.001}],
}


def main(folder: Path) -> None:
    """Everything that a scene leaves out has a documented default."""
    file = folder / "my-ring.json"
    file.write_text(json.dumps(SCENE, indent=2))
    request = pipeline.GenerateRequest(dataset=str(folder / "mine"), scenes=str(file), frames=15)
    print(pipeline.generate(request, pipeline.Run(executor="serial")).as_text())


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
