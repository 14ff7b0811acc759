"""A sequence of actions from JSON, and a gripper of your own as an STL file.

Run: python examples/05_cut_join_and_your_own_tool.py [FOLDER]
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import trimesh

import doughdata

FRAMES = 17
HERE = Path(__file__).parent
SCENES = "05_cut_join_and_your_own_tool.json"


def make_wedge(path: Path) -> None:
    """A wedge of 60 degrees in millimetres: tip in the plane x = 0, lowest point at z = 0."""
    outline = [(0, 2), (0, -2), (14, -9), (14, 9)]
    corners = np.array([(x, y, z) for x, y in outline for z in (0, 40)], dtype=float)
    trimesh.Trimesh(vertices=corners).convex_hull.export(path)


def main(folder: Path) -> None:
    """Two scenes of one file: a bar is cut and joined again; a ring is parted with wedges."""
    folder.mkdir(parents=True, exist_ok=True)
    make_wedge(folder / "wedge.stl")
    (folder / SCENES).write_text((HERE / SCENES).read_text())
    command = [str(Path(sys.executable).with_name("doughdata")), "generate", "--scenes", SCENES]
    subprocess.run(
        [*command, "--frames", str(FRAMES), "--workers", "1", "--dataset", "mine"],
        cwd=folder,
        check=True,
    )
    ds = doughdata.open_dataset(str(folder / "mine"))
    seen = {}
    for scene in (0, 1):
        frames = [ds.frame(scene=scene, frame=k) for k in range(FRAMES)]
        seen[scene] = [frame.topology.genus for frame in frames]
        print(f"{ds.scene(scene).scene_id}: genus of the components {seen[scene]}")
        assert all(len(frame.meshes) == frame.topology.num_components for frame in frames)
    assert max(map(len, seen[0])) == 2, "the bar was cut"
    assert len(seen[0][-1]) == 1, "and is one piece again"
    assert (seen[1][0], seen[1][-1]) == ((1,), (0,)), "a ring, then a rod"


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
