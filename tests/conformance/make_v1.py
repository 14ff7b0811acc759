"""Writes the stored datasets of format 1.0. Run ONCE, when the format stands; never again.

    python -m tests.conformance.make_v1

Two datasets of cubes (`tests/closed_form.py`):

- `cubes`: two user-written scenes in one shard, all layers.
- `retried`: a family's two scenes, a shard each; one failed in `sim` and was retried (revision 1),
  the other fails in `topology`; no mesh, no depth.

`expected.json` beside each holds what a reader must find. Its values are counted by hand or follow
from whole numbers; none is read back from what was written.
"""

import json
import shutil
from pathlib import Path
from typing import Any

from doughdata.dataset import DatasetSettings, DatasetWriter, open_writer
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import STAGES, write_examples

ROOT = Path(__file__).parent / "v1"
S = 0.002  # [m], side of a cube
CUBES: dict[str, Any] = {
    "schema_version": "1.0",
    "num_frames": 3,
    "layers": ["sim", "topology", "mesh", "depth.none"],
    "scene_ids": ["closed-form-cut-ring", "closed-form-joined-bars"],
    "scenes": {
        "0": {
            "num_particles": 144,  # (8 * 8 - 4 * 4) * 3
            "first_particle": [[-3.5 * S, -3.5 * S, S / 2]] * 2 + [[-4.5 * S, -3.5 * S, S / 2]],
            "genus": [[1], [0], [0, 0]],
            "static_genus": [[1], [0], [0, 0]],
            "particles_of_component": [[144], [144], [72, 72]],
            "graph_nodes": [4, 4, 2],
            "graph_edges": [4, 3, 0],
            "events": [[1, "self_split", [0], [0]], [2, "split", [0], [0, 1]]],
            "bonds_made": [312, 4, 4],
            "bonds_broken": [0, 18, 18],
            "contacts": [0, 0, 0],
            "mesh_volume": [[144 * S**3], [144 * S**3], [72 * S**3, 72 * S**3]],
            "mesh_euler": [[0], [2], [2, 2]],
            # The camera looks down from 0.3 m; the highest cube ends at 3, then at 6 cubes.
            "least_depth": [0.3 - 3 * S, 0.3 - 6 * S, 0.3 - 6 * S],
            "opening": [0.1, 0.052, 0.004],
            "timestamps": [0.0, 0.96, 1.92],  # (0.1 - 0.004) / (2 * 0.025) in all
        },
        "1": {
            "num_particles": 240,  # 2 * 4 * 10 * 3
            "first_particle": [[-4.5 * S, -4.5 * S, S / 2]] + [[-3.5 * S, -4.5 * S, S / 2]] * 2,
            "genus": [[0, 0], [0, 0], [0]],
            "static_genus": [[0, 0], [0], [0]],
            "particles_of_component": [[120, 120], [120, 120], [240]],
            "graph_nodes": [2, 2, 2],
            "graph_edges": [0, 0, 1],
            "events": [[2, "merge", [0, 1], [0]]],
            "bonds_made": [556, 0, 30],  # 2 * (3*10*3 + 4*9*3 + 4*10*2), then a face of 10 * 3
            "bonds_broken": [0, 0, 0],
            "contacts": [0, 30, 0],
            "mesh_volume": [[120 * S**3] * 2, [120 * S**3] * 2, [240 * S**3]],
            "mesh_euler": [[2, 2], [2, 2], [2]],
            "least_depth": [0.3 - 3 * S] * 3,
            "opening": [0.1, 0.052, 0.004],
            "timestamps": [0.0, 0.96, 1.92],
        },
    },
}
RING_SIM = {
    key: CUBES["scenes"]["0"][key]
    for key in ("num_particles", "first_particle", "opening", "timestamps")
}
RING_TOPOLOGY = {
    key: CUBES["scenes"]["0"][key]
    for key in ("genus", "static_genus", "particles_of_component", "events", "contacts")
}
RETRIED: dict[str, Any] = {
    "schema_version": "1.0",
    "num_frames": 3,
    "layers": ["sim", "topology"],
    "scene_ids": ["rolls-train-s0-000000", "rolls-train-s0-000001"],
    "scenes": {"0": {**RING_SIM, **RING_TOPOLOGY}, "1": RING_SIM},
    "failed": {"1": {"topology": "ValueError: no such neck"}},
}


def make_cubes(path: Path) -> DatasetWriter:
    """All layers, one shard."""
    settings = DatasetSettings(num_frames=NUM_FRAMES, scenes_per_shard=2, stages=STAGES)
    return write_examples(open_writer(path, settings), [cut_ring(), joined_bars()])


def make_retried(path: Path) -> DatasetWriter:
    """A failure that was retried, and one that stands."""
    writer = open_writer(path, DatasetSettings(num_frames=NUM_FRAMES, stages=STAGES))
    ring = cut_ring()
    writer.plan_family("rolls", split="train", seed=0, count=2)
    one, two = writer.tasks("sim")
    writer.write(one, {}, failed={0: "SimulationError: too fast"}, stage=STAGES["sim"])
    writer.write(two, {1: ring.particles}, stage=STAGES["sim"])
    (again,) = writer.tasks("sim", retry_failed=True)
    writer.write(again, {0: ring.particles}, stage=STAGES["sim"])
    one, two = writer.tasks("topology")
    writer.write(one, {0: ring.topology}, stage=STAGES["topology"])
    reason = RETRIED["failed"]["1"]["topology"]
    writer.write(two, {}, failed={1: reason}, stage=STAGES["topology"])
    writer.refresh()
    return writer


def make(root: Path) -> None:
    """Write both datasets and their `expected.json` into an empty folder."""
    for name, function, expected in (
        ("cubes", make_cubes, CUBES),
        ("retried", make_retried, RETRIED),
    ):
        function(root / name / "dataset")
        (root / name / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    if (ROOT / "cubes").exists():
        raise SystemExit(f"{ROOT} is frozen: a new version gets a folder of its own")
    try:
        make(ROOT)
    except BaseException:
        for folder in ("cubes", "retried"):
            shutil.rmtree(ROOT / folder, ignore_errors=True)
        raise
