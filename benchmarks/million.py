"""What a million scenes cost: CPU-hours, bytes, files and requests, from a few that are made here.

`python benchmarks/million.py --json` prints one JSON object on one line. Scenes of the two families
of the paper go through the real pipeline in this process (75 key frames, preset draft, one depth
sensor), after a small scene that takes imports and compilation away. CPU-seconds are of this
machine; bytes and files follow from the format. Requests are those of an object store: a put a
file, one list a layer, and what reading one full key frame asks for, the first time in a shard and
later.
"""

import argparse
import json
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from doughdata import pipeline, registry
from doughdata.dataset import DatasetSettings, open_dataset
from doughdata.dataset.commits import CommitLog
from doughdata.dataset.store import LocalStore
from doughdata.executors.serial import SerialExecutor
from doughdata.render.depth import DepthStage
from doughdata.requests import FamilyScenes, Stages
from doughdata.sim.mpm import MpmSimulator, draft
from doughdata.sim.pull import MpmPullApart

MILLION = 1_000_000
FRAMES, SCENES_PER_SHARD, SENSOR = 75, 32, "realsense"
FAMILIES = ("rolls", "doughnut")


class CountingStore(LocalStore):
    """A folder that counts what would be requests to an object store."""

    def __init__(self, uri: str | Path) -> None:
        super().__init__(uri)
        self.requests: Counter[str] = Counter()

    def read(self, path: str) -> bytes:
        """One get."""
        self.requests["get"] += 1
        return super().read(path)

    def read_range(self, path: str, start: int, stop: int | None = None) -> bytes:
        """One get of a range."""
        self.requests["get"] += 1
        return super().read_range(path, start, stop)

    def names(self, folder: str) -> list[str]:
        """One list."""
        self.requests["list"] += 1
        return super().names(folder)


def make(folder: str, families: tuple[str, ...], each: int) -> dict[str, float]:
    """Make scenes; CPU-seconds a layer."""
    stages = {
        "sim": Stages(simulator=MpmSimulator(draft())),
        "topology": Stages(check=registry.load("topology", "dynamic")(pull_apart=MpmPullApart())),
        "mesh": Stages(mesher=registry.load("meshers", "dual-contouring")()),
    }
    wanted = [FamilyScenes(family=family, count=each) for family in families]
    settings = DatasetSettings(num_frames=FRAMES, scenes_per_shard=SCENES_PER_SHARD)
    spent = {}
    for layer, stage in stages.items():
        start = time.process_time()
        pipeline.generate(folder, wanted, stage, SerialExecutor(), settings=settings)
        spent[layer] = time.process_time() - start
    start = time.process_time()
    sensors = {SENSOR: registry.load("sensors", SENSOR)()}
    pipeline.render(folder, DepthStage(), sensors, SerialExecutor())
    return {**spent, f"depth.{SENSOR}": time.process_time() - start}


def contents(folder: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Layer -> bytes of all its attempts; layer -> files of one attempt."""
    size: dict[str, int] = defaultdict(int)
    for path in (folder / "data").rglob("*"):
        if path.is_file():
            size[path.relative_to(folder / "data").parts[0]] += path.stat().st_size
    log = CommitLog(LocalStore(folder))
    newest = {layer: log.newest(layer, log.shards[0]) for layer in log.layers}
    return dict(size), {k: len(commit.files) for k, commit in newest.items() if commit is not None}


def requests(folder: Path) -> dict[str, int]:
    """Gets of one full key frame: of a shard that is met for the first time, and of a known one."""
    store = CountingStore(folder)
    dataset = open_dataset(store)
    found = {}
    for name, frame in (("first", 30), ("next", 35)):
        before = store.requests.total()
        opened = dataset.frame(scene=0, frame=frame)
        parts = (opened.particles, opened.topology, opened.meshes, opened.label_grid)
        assert all(part is not None for part in (*parts, opened.tools, opened.depth(SENSOR)))
        found[name] = store.requests.total() - before
    return found


def measure(each: int) -> dict[str, Any]:
    """Make, count and multiply."""
    with tempfile.TemporaryDirectory() as place:
        make(f"{place}/warm", ("ball",), 1)
        folder = Path(place) / "dataset"
        spent = make(str(folder), FAMILIES, each)
        scenes = open_dataset(folder).info["total_scenes"]
        size, files = contents(folder)
        reads = requests(folder)
    shards = -(-MILLION // SCENES_PER_SHARD)
    puts = shards * sum(count + 1 for count in files.values())  # the commit is one more
    return {
        "scenes": MILLION,
        "cpu_hours": {layer: round(s / scenes * MILLION / 3600) for layer, s in spent.items()},
        "cpu_hours_total": round(sum(spent.values()) / scenes * MILLION / 3600),
        "terabytes": {layer: round(s / scenes * MILLION / 1e12, 2) for layer, s in size.items()},
        "terabytes_total": round(sum(size.values()) / scenes * MILLION / 1e12, 2),
        "shards": shards,
        "files": puts,
        "put_requests": puts,
        "get_requests_first_frame_of_shard": reads["first"],
        "get_requests_next_frame": reads["next"],
        "measured_scenes": scenes,
        "measured_cpu_s_per_scene": round(sum(spent.values()) / scenes, 2),
        "measured_bytes_per_scene": round(sum(size.values()) / scenes),
        "files_per_shard": files,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--each", type=int, default=2, help="scenes a family that are made")
    options = parser.parse_args()
    found = measure(options.each)
    print(json.dumps(found) if options.json else json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
