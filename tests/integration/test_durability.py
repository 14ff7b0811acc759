"""Killed, damaged, full: nothing that was finished is lost."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from doughdata import open_dataset
from tests.integration.conftest import FRAMES, TINY, command, squeeze


def committed(dataset: Path) -> dict[str, str]:
    """Hashes of every file that a commit record names."""
    found = {}
    for record in (dataset / "meta" / "commits").rglob("*.json"):
        commit = json.loads(record.read_text())
        for name in commit["files"]:
            path = dataset / commit["path"] / name
            found[str(path.relative_to(dataset))] = sha256(path.read_bytes()).hexdigest()
    return found


def started(arguments: tuple, cwd: Path, until: Callable[[Path], object]) -> subprocess.Popen[str]:
    """Start `doughdata` in a process group of its own and wait until its dataset is so far."""
    process = subprocess.Popen(
        [str(Path(sys.executable).with_name("doughdata")), *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell starts background jobs with SIGINT ignored; a terminal does not.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    while not until(cwd / "dough-dataset"):
        assert process.poll() is None, f"ended too early: {process.communicate()}"
        time.sleep(0.01)
    return process


def test_kill_nine_then_the_same_command(tiny_scenes: Path, tmp_path: Path) -> None:
    """After SIGKILL in the middle, the same command keeps finished shards and makes the rest."""
    options = ("--frames", FRAMES, "--executor", "serial")
    arguments = ("generate", "--scenes", tiny_scenes, *options)
    process = started(arguments, tmp_path, lambda d: list(d.glob("meta/commits/sim/*.json")))
    process.kill()
    process.communicate()
    dataset = tmp_path / "dough-dataset"
    before = committed(dataset)
    assert before
    done = command(*arguments, "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["kept"]["sim"] >= 1
    after = committed(dataset)
    assert before == {name: after[name] for name in before}
    command("validate", "--deep", cwd=tmp_path)


def test_one_and_two_workers_make_the_same_sim_layer(
    tiny_dataset: Path, tiny_scenes: Path, tmp_path: Path
) -> None:
    """The sha256 of every array file of `sim` is the same for one and for two workers."""
    options = (
        "--frames",
        FRAMES,
        "--stages",
        "simulate",
        "--executor",
        "processes",
        "--workers",
        2,
    )
    command("generate", "--scenes", tiny_scenes, *options, cwd=tmp_path)

    def arrays(dataset: Path) -> list[dict[str, str]]:
        records = sorted((dataset / "meta" / "commits" / "sim").glob("*.json"))
        files = [json.loads(record.read_text())["files"] for record in records]
        return [{k: v for k, v in one.items() if k.startswith("arrays.zarr")} for one in files]

    assert arrays(tmp_path / "dough-dataset") == arrays(tiny_dataset)


@pytest.mark.slow
def test_one_flipped_byte_is_found_and_named(tiny_dataset: Path, tmp_path: Path) -> None:
    """Any byte of any file under data/ may flip: validate --deep names the file, exit code 1."""
    copy = shutil.copytree(tiny_dataset, tmp_path / "dough")
    files = sorted(p for p in (copy / "data").rglob("*") if p.is_file() and p.stat().st_size)
    rng = random.Random(0)
    kinds = {p.name if p.suffix else "chunk": p for p in rng.sample(files, len(files))}
    for path in kinds.values():
        data = path.read_bytes()
        place = rng.randrange(len(data))
        path.write_bytes(
            data[:place] + bytes([data[place] ^ (1 << rng.randrange(8))]) + data[place + 1 :]
        )
        done = command("validate", "--deep", "--dataset", copy, cwd=tmp_path, code=1)
        assert str(path.relative_to(copy)) in done.stdout
        path.write_bytes(data)


def test_a_byte_inside_a_frame_names_the_frame(tiny_dataset: Path, tmp_path: Path) -> None:
    """A damaged chunk of positions is told with its scene and key frame."""
    copy = shutil.copytree(tiny_dataset, tmp_path / "dough")
    record = json.loads((copy / "meta" / "commits" / "sim" / "00001.0.json").read_text())
    chunk = next((copy / record["path"] / "arrays.zarr" / "positions" / "c").rglob("0/0/0"))
    data = bytearray(chunk.read_bytes())
    data[5] ^= 1  # the shard begins with the chunk of its first row
    chunk.write_bytes(bytes(data))
    done = command("validate", "--deep", "--dataset", copy, cwd=tmp_path, code=1)
    assert any("scene 1" in line and "frame 0" in line for line in done.stdout.splitlines()), (
        done.stdout
    )


def test_ctrl_c_is_told_in_one_line(tiny_scenes: Path, tmp_path: Path) -> None:
    """SIGINT to the whole process group, as a terminal sends it: one line and no traceback."""
    arguments = ("generate", "--scenes", tiny_scenes, "--frames", FRAMES, "--workers", 2)
    process = started(arguments, tmp_path, lambda d: (d / "meta" / "plans").exists())
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert "Traceback" not in error
    assert "interrupted" in error.strip().splitlines()[-1]


def test_a_full_disk_is_told_and_loses_nothing(tiny_scenes: Path, tmp_path: Path) -> None:
    """When no file may grow further, the run stops with one line and a later run finishes."""
    options = ("--frames", FRAMES, "--executor", "serial", "--stages", "simulate")
    words = (Path(sys.executable).with_name("doughdata"), "generate", "--scenes", tiny_scenes)
    script = f"trap '' XFSZ; ulimit -f 64; exec {' '.join(map(str, (*words, *options)))}"
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert "file too large" in done.stderr.splitlines()[-1]
    command("generate", "--scenes", tiny_scenes, *options, cwd=tmp_path)
    command("validate", "--deep", cwd=tmp_path)


def test_a_scene_that_fails_is_named_and_costs_only_itself(tmp_path: Path) -> None:
    """In one shard, a scene whose second action begins inside dough fails by name; two go on."""
    inside = squeeze(0.001, start=0.004, yaw=1.5)
    bad = {**TINY[1], "scene_id": "bad", "actions": [*TINY[1]["actions"], inside]}
    last = {**TINY[1], "scene_id": "last"}
    (tmp_path / "three.json").write_text(json.dumps([TINY[1], bad, last]))
    options = ("--stages", "simulate", "--scenes-per-shard", 3, "--dataset", "dough", "--json")
    made = command(
        *("generate", "--scenes", "three.json", "--frames", 6, *options), cwd=tmp_path, code=1
    )
    failed = json.loads(made.stdout)["failed"]["sim"]
    assert list(failed) == ["1"]
    assert "action 1: finger" in failed["1"]
    dataset = open_dataset(tmp_path / "dough")
    assert dataset.scene_indices == [0, 2]
    assert all(np.isfinite(dataset.read_particles(k).positions).all() for k in (0, 2))
    record = dataset.layer("sim", 0).commit
    assert "inside the dough" in record.failed[1]
