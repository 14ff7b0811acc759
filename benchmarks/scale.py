"""Ten thousand scenes: is a large dataset quick to open and to read?

`python benchmarks/scale.py --json` prints one JSON object on one line. The records are tiny and
synthetic (the closed-form ring of the tests: 3 key frames, 144 particles, all layers), but pass
through the real writer into shards of 32 scenes. A process of its own opens the dataset (`open_s`,
imports not counted) and reads random full key frames, each from a shard that chance chooses
(`frame_ms`, the median; `frame_ms_worst` the 99th percentile). It reads the same frames twice: the
first time it meets most shards for the first time (`first_frame_ms`), and keeps what is small.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.dataset import Dataset, DatasetSettings, DatasetWriter, open_dataset, open_writer
from tests.closed_form import NUM_FRAMES, cut_ring
from tests.dataset_helpers import LAYERS, STAGES, record_of

SCENES_PER_SHARD = 32
READS = 500


def make(folder: Path, scenes: int) -> DatasetWriter:
    """Write all layers of that many scenes."""
    settings = DatasetSettings(
        num_frames=NUM_FRAMES, scenes_per_shard=SCENES_PER_SHARD, stages=STAGES
    )
    writer = open_writer(folder, settings)
    writer.plan_family("ball", split="train", seed=0, count=scenes)
    example = cut_ring()
    for layer in LAYERS:
        for task in writer.tasks(layer):
            records = dict.fromkeys(task.scenes, record_of(example, layer))
            writer.write(task, records, stage=STAGES[layer])
    writer.refresh()
    return writer


def read(folder: Path) -> dict[str, float]:
    """Open, then read random full key frames, twice the same; wall clock."""
    start = time.perf_counter()
    dataset = open_dataset(folder)
    opened = time.perf_counter() - start
    first, again = read_frames(dataset), read_frames(dataset)
    return {
        "open_s": round(opened, 4),
        "frame_ms": round(1e3 * float(np.median(again)), 3),
        "frame_ms_worst": round(1e3 * float(np.quantile(again, 0.99)), 3),
        "first_frame_ms": round(1e3 * float(np.median(first)), 3),
    }


def read_frames(dataset: Dataset) -> list[float]:
    """Seconds of each of some random full key frames."""
    rng = np.random.default_rng(0)
    times = []
    for scene in rng.integers(0, dataset.info["total_scenes"], READS).tolist():
        start = time.perf_counter()
        frame = dataset.frame(scene=scene, frame=int(rng.integers(NUM_FRAMES)))
        assert len(frame.particles.positions) > 0
        assert len(frame.meshes) == frame.topology.num_components
        assert frame.label_grid.labels.any()
        assert frame.depth("none").depth.any()
        assert frame.tools.opening >= 0
        times.append(time.perf_counter() - start)
    return times


def measure(scenes: int) -> dict[str, Any]:
    """Write a dataset, read it in a new process, count its files."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "dataset"
        start = time.process_time()
        make(folder, scenes)
        write_s = time.process_time() - start
        command = [sys.executable, __file__, "--read", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        files = sum(path.is_file() for path in folder.rglob("*"))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    found = json.loads(done.stdout)
    return {"scenes": scenes, **found, "files": files, "bytes": size, "write_cpu_s": write_s}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--read", type=Path, help="only read this dataset")
    options = parser.parse_args()
    found = read(options.read) if options.read else measure(options.scenes)
    print(json.dumps(found) if options.json or options.read else json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
