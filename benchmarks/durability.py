"""Killed at random, raced and bit by bit damaged: does a dataset lose, double or hide anything?

`python benchmarks/durability.py --json` prints one JSON object on one line. Everything happens on a
local disk and in an S3 bucket (a moto server on loopback).

- Kills: a process that writes layer after layer is killed with SIGKILL at a random moment and
  started again, until the dataset is whole. Most of these processes write synthetic records (the
  closed forms of the tests) through the real writer; `command_kills` of them are whole
  `doughdata generate` commands with their workers. `lost` counts scenes without all layers and
  commit records that vanished or changed, `doubled` scenes or shards that are there twice,
  `bad_hashes` problems of `validate --deep`. The dataset must have the fingerprint of one that
  nobody killed.
- Races: two processes write the same dataset at once; `races` counts the shards and layers,
  `races_won_twice` those with more than one revision, `races_orphans` attempts left over.
- Flips: one bit of one file is flipped, `validate` runs, the bit is put back; `flips_found`.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from doughdata.dataset import DatasetSettings, open_dataset, open_writer, validate
from doughdata.dataset.commits import all_revisions, list_layers
from doughdata.dataset.store import store_of
from tests.closed_form import NUM_FRAMES, Example, cut_ring, joined_bars
from tests.dataset_helpers import LAYERS, STAGES, record_of
from tests.integration.conftest import TINY
from tests.object_store import BUCKET, environment, object_store, set_environment

SCENES, SCENES_PER_SHARD = 8, 2
COMMAND_FRAMES = 4
LONGEST = 10.0  # [s] that a command is left alone, at most


def examples() -> list[Example]:
    """Closed forms under names of their own."""
    both = (cut_ring(), joined_bars())
    named = [(both[k % 2], f"example-{k:03d}") for k in range(SCENES)]
    return [replace(e, scene=replace(e.scene, scene_id=name)) for e, name in named]


def write(uri: str) -> None:
    """What a killed process does: make or continue the dataset, layer after layer."""
    every = examples()
    print("ready", flush=True)
    settings = DatasetSettings(
        num_frames=NUM_FRAMES, scenes_per_shard=SCENES_PER_SHARD, stages=STAGES
    )
    writer = open_writer(uri, settings)
    writer.plan_scenes([example.scene for example in every])
    for layer in LAYERS:
        for task in writer.tasks(layer):
            records = {i: record_of(every[i], layer) for i in task.scenes}
            writer.write(task, records, stage=STAGES[layer])
    writer.refresh()


class Killed:
    """One dataset that is written by processes which are killed."""

    def __init__(self, uri: str, command: list[str], rng: random.Random) -> None:
        self.uri, self.command, self.rng = uri, command, rng
        self.kills = self.lost = 0
        self._records: dict[str, str] = {}  # commit record -> sha256, as seen after a kill

    def run(self, longest: float) -> bool:
        """Start the command and kill it after 0..`longest` seconds; whether it ended by itself."""
        process = start(self.command)
        try:
            process.wait(self.rng.uniform(0.0, longest))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            self.kills += 1
            self._compare()
            return False
        if process.returncode != 0:
            raise SystemExit(f"{self.command} failed: {process.returncode}")
        return True

    def finish(self) -> float:
        """Let the command end; returns its seconds."""
        begin = time.monotonic()
        process = start(self.command)
        if process.wait() != 0:
            raise SystemExit(f"{self.command} failed: {process.returncode}")
        self._compare()
        return time.monotonic() - begin

    def _compare(self) -> None:
        """Every commit record that was there is there unchanged."""
        store = store_of(self.uri)
        now = {
            name: sha256(store.read(f"meta/commits/{name}")).hexdigest()
            for name in store.walk("meta/commits")
            if not Path(name).name.startswith(".tmp-")
        }
        self.lost += sum(now.get(name) != digest for name, digest in self._records.items())
        self._records = now


def start(command: list[str]) -> subprocess.Popen[str]:
    """A process group of its own; the synthetic writer says when it begins to write."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    if "--write" in command:
        assert process.stdout is not None
        process.stdout.readline()
    return process


def state(uri: str, scenes: int, layers: tuple[str, ...]) -> Counter[str]:
    """What is lost, doubled or bad in a dataset that should be whole."""
    found = Counter(bad_hashes=len(validate(uri, deep=True).problems))
    dataset, store = open_dataset(uri), store_of(uri)
    indices = dataset.scene_indices
    found["doubled"] += len(indices) - len(set(indices))
    for layer in layers:
        revisions = all_revisions(store, layer) if layer in list_layers(store) else {}
        found["doubled"] += sum(len(several) - 1 for several in revisions.values())
        for index in range(scenes):
            try:
                dataset.layer(layer, index)
            except Exception:
                found["lost"] += 1
    return found


def kill_writers(uri: str, kills: int, rng: random.Random, fingerprint: str) -> Counter[str]:
    """Kill the synthetic writer until that many kills are done; then look."""
    found: Counter[str] = Counter()
    part = 0
    longest = 0.0
    while found["kills"] < kills:
        place = f"{uri}-{part}"
        part += 1
        killed = Killed(place, [sys.executable, __file__, "--write", place], rng)
        if not longest:
            spare = Killed(
                f"{uri}-whole", [sys.executable, __file__, "--write", f"{uri}-whole"], rng
            )
            longest = spare.finish()
        while found["kills"] + killed.kills < kills and not killed.run(longest / 2):
            pass
        killed.finish()
        found += state(place, SCENES, LAYERS)
        found["kills"] += killed.kills
        found["lost"] += killed.lost
        found["other_fingerprint"] += open_dataset(place).fingerprint != fingerprint
    return found


def kill_commands(uri: str, kills: int, rng: random.Random, folder: Path) -> Counter[str]:
    """The same with `doughdata generate` and its workers, on real tiny scenes."""
    scenes = folder / "tiny.json"
    scenes.write_text(json.dumps([{**TINY[1], "scene_id": f"cut-{k}"} for k in range(3)]))
    program = str(Path(sys.executable).with_name("doughdata"))
    options = ("--frames", str(COMMAND_FRAMES), "--executor", "processes", "--workers", "2")
    command = [program, "generate", "--scenes", str(scenes), *options, "--dataset"]
    found: Counter[str] = Counter()
    part = 0
    while found["kills"] < kills:  # a dataset that is whole before its time gives way to another
        place = f"{uri}-{part}"
        part += 1
        killed = Killed(place, [*command, place], rng)
        while found["kills"] + killed.kills < kills and not killed.run(LONGEST):
            pass
        killed.finish()
        found += state(place, 3, LAYERS[:3])
        found += Counter(kills=killed.kills, command_kills=killed.kills, lost=killed.lost)
    return found


def race(uri: str) -> Counter[str]:
    """Two processes write the same dataset at once."""
    command = [sys.executable, __file__, "--write", uri]
    both = [start(command) for _ in range(2)]
    if any(process.wait() != 0 for process in both):
        raise SystemExit("a racing writer failed")
    store = store_of(uri)
    revisions = [r for layer in LAYERS for r in all_revisions(store, layer).values()]
    found = state(uri, SCENES, LAYERS)
    return Counter(
        races=len(revisions),
        races_won_twice=sum(len(several) > 1 for several in revisions),
        races_orphans=int(validate(uri).figures["orphans"]),
        lost=found["lost"],
        bad_hashes=found["bad_hashes"],
    )


def flip_bits(folder: Path, flips: int, rng: random.Random) -> Counter[str]:
    """Flip single bits over all files of a dataset: every file in turn, and by size in between."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    weights = [path.stat().st_size for path in files]
    found: Counter[str] = Counter(flips=flips)
    for k in range(flips):
        (path,) = [files[k % len(files)]] if k % 2 else rng.choices(files, weights)
        data = path.read_bytes()
        place, bit = rng.randrange(len(data)), rng.randrange(8)
        path.write_bytes(data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :])
        report = validate(folder)
        named = path.relative_to(folder).as_posix() in {p.file for p in report.problems}
        found["flips_found"] += not report.ok
        found["flips_named"] += named
        path.write_bytes(data)
    return found


def places(folder: Path) -> Iterator[str]:
    """Where everything happens: a folder, and a bucket on a server that runs meanwhile."""
    yield str(folder / "local")
    with object_store() as endpoint, set_environment(**environment(endpoint)):
        yield f"s3://{BUCKET}/dough"


def measure(kills: int, command_kills: int, flips: int, seed: int) -> Mapping[str, Any]:
    """All of it."""
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    began = time.monotonic()
    folder = Path(tempfile.mkdtemp())
    try:
        reference = str(folder / "reference")
        Killed(reference, [sys.executable, __file__, "--write", reference], rng).finish()
        fingerprint = open_dataset(reference).fingerprint
        for uri in places(folder):
            found += kill_writers(f"{uri}-killed", kills // 2, rng, fingerprint)
            found += race(f"{uri}-raced")
            found += kill_commands(f"{uri}-commands", command_kills // 2, rng, folder)
        found += flip_bits(Path(reference), flips, rng)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    keys = ("kills", "command_kills", "lost", "doubled", "bad_hashes", "other_fingerprint")
    keys += ("races", "races_won_twice", "races_orphans", "flips", "flips_found", "flips_named")
    return {**{key: found[key] for key in keys}, "wall_s": round(time.monotonic() - began)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--write", metavar="URI", help="only write the synthetic dataset")
    parser.add_argument("--kills", type=int, default=50, help="of the synthetic writer")
    parser.add_argument("--command-kills", type=int, default=6, help="of `doughdata generate`")
    parser.add_argument("--flips", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.write:
        write(options.write)
        return
    found = measure(options.kills, options.command_kills, options.flips, options.seed)
    print(json.dumps(found) if options.json else json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
