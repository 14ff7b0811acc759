"""`--retry-failed`: only failed scenes are worked on again, and only what changed is renewed."""

# ruff: noqa: ARG002, D102 (methods of the stage protocols, with their arguments)

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from doughdata import pipeline
from doughdata.dataset import DatasetSettings, open_dataset, validate
from doughdata.dataset.collect import collect
from doughdata.executors import WorkerCrash
from doughdata.executors.serial import SerialExecutor
from doughdata.requests import Stages, Summary
from doughschemas import ComponentMeshes, FrameTopology, Particles, Scene, Topology
from tests.closed_form import NUM_FRAMES, Example, cut_ring, joined_bars
from tests.dataset_helpers import equal
from tests.integration.conftest import TINY, command, squeeze

EXAMPLES = {e.scene.scene_id: e for e in (cut_ring(), joined_bars())}
RING, BARS = EXAMPLES.values()


@dataclass(frozen=True)
class Plugin:
    """A third party's stages: they look the closed forms up, note whom they work on, may fail."""

    notes: str
    fails: str = ""  # scene_id

    def simulate(self, scene: Scene, *, rng: np.random.Generator) -> Particles:
        return self._found("sim", scene.scene_id).particles

    def check(self, scene: Scene, particles: Particles) -> Topology:
        return self._found("topology", scene.scene_id).topology

    def mesh(
        self, positions: np.ndarray, topology: FrameTopology, *, spacing: float
    ) -> ComponentMeshes:
        for example in EXAMPLES.values():
            for k, own in enumerate(example.particles.positions):
                if equal(own, positions) and equal(example.topology.frames[k], topology):
                    return self._found("mesh", example.scene.scene_id).meshes[k]
        raise AssertionError("positions of no example")

    def _found(self, layer: str, scene_id: str) -> Example:
        with Path(self.notes).open("a") as notes:
            notes.write(f"{layer} {scene_id}\n")
        if scene_id == self.fails:
            raise RuntimeError("not today")
        return EXAMPLES[scene_id]


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., tuple[Summary, set[str]]]:
    """Make both examples in one shard; returns the summary and who was worked on."""

    def run(*, fails: tuple[str, ...] = ("", "", ""), executor=None, only="", place="d", **options):
        notes = tmp_path / "notes.txt"
        notes.write_text("")
        sim, check, mesher = (Plugin(str(notes), name) for name in fails)
        stages = Stages(simulator=sim, check=check, mesher=mesher)
        summary = pipeline.generate(
            str(tmp_path / place),
            [example.scene for example in EXAMPLES.values()],
            Stages(simulator=sim) if only == "sim" else stages,
            executor or SerialExecutor(),
            settings=DatasetSettings(num_frames=NUM_FRAMES, scenes_per_shard=2),
            **options,
        )
        return summary, set(notes.read_text().splitlines())

    return run


def everything(path: Path) -> bool:
    """Whether all layers of both examples are there, bit for bit."""
    dataset = open_dataset(path)
    return validate(path, deep=True).ok and all(
        equal(dataset.read_particles(k), example.particles)
        and equal(dataset.read_topology(k), example.topology)
        and all(equal(dataset.read_meshes(k, f), example.meshes[f]) for f in range(NUM_FRAMES))
        for k, example in enumerate(EXAMPLES.values())
    )


@pytest.mark.parametrize("layer", [0, 1, 2], ids=["sim", "topology", "mesh"])
def test_a_retry_works_on_the_failed_scene_alone(run, tmp_path: Path, layer: int) -> None:
    """Whatever layer failed, the good scene is made once in all layers; nobody sees the detour."""
    fails = tuple(RING.scene.scene_id if k == layer else "" for k in range(3))
    first, _ = run(fails=fails)
    assert first.failed
    _, again = run()
    assert again == set(), "without --retry-failed nothing is tried again"
    second, worked_on = run(retry_failed=True)
    names = ("sim", "topology", "mesh")
    assert worked_on == {f"{name} {RING.scene.scene_id}" for name in names[layer:]}
    assert second.failed == {}
    assert (second.made["mesh"], second.kept["mesh"]) == (1, 1)
    assert everything(tmp_path / "d")
    run(place="straight")
    straight = open_dataset(tmp_path / "straight").fingerprint
    assert open_dataset(tmp_path / "d").fingerprint == straight


def test_a_retry_that_fails_again_renews_nothing(run, tmp_path: Path) -> None:
    """The old revision stays, so later layers stay fresh; the reason is still told."""
    fails = (RING.scene.scene_id, "", "")
    run(fails=fails)
    before = sorted(p.name for p in (tmp_path / "d").rglob("*.json"))
    summary, worked_on = run(fails=fails, retry_failed=True)
    assert worked_on == {f"sim {RING.scene.scene_id}"}
    assert summary.failed == {"sim": {0: "RuntimeError: not today"}}
    assert sorted(p.name for p in (tmp_path / "d").rglob("*.json")) == before
    assert equal(open_dataset(tmp_path / "d").read_meshes(1, 0), BARS.meshes[0])


class Dies(SerialExecutor):
    """Reports what an executor reports when the worker of every item is killed."""

    def map(self, function, items):
        yield from (WorkerCrash(item=item, reason="killed") for item in items)


def test_a_crash_in_a_retry_leaves_the_good_scenes(run, tmp_path: Path) -> None:
    """If the worker dies while it retries, the scenes that were good before are not lost."""
    run(fails=(RING.scene.scene_id, "", ""))
    summary, _ = run(retry_failed=True, executor=Dies())
    assert summary.failed["sim"] == {0: "RuntimeError: not today"}
    assert equal(open_dataset(tmp_path / "d").read_topology(1), BARS.topology)


def test_what_gc_has_removed_is_made_again(run, tmp_path: Path) -> None:
    """A stale layer whose old upstream was collected cannot be judged: all of it is made again."""
    run(fails=(RING.scene.scene_id, "", ""))
    run(retry_failed=True, only="sim")
    assert len(collect(tmp_path / "d", grace=0.0).superseded) == 1
    _, worked_on = run()
    assert f"topology {BARS.scene.scene_id}" in worked_on
    assert everything(tmp_path / "d")


def test_commands_retry_a_scene_that_cannot_succeed(tmp_path: Path) -> None:
    """The real simulator refuses the same scene again; the good one is neither made nor lost."""
    inside = squeeze(0.001, start=0.004, yaw=1.5)
    bad = {**TINY[1], "scene_id": "bad", "actions": [*TINY[1]["actions"], inside]}
    (tmp_path / "two.json").write_text(json.dumps([TINY[1], bad]))
    options = (
        "--scenes",
        "two.json",
        "--frames",
        4,
        "--stages",
        "simulate",
        "--executor",
        "serial",
    )
    more = ("--scenes-per-shard", 2, "--json")
    command("generate", *options, *more, cwd=tmp_path, code=1)
    retried = command("generate", *options, "--retry-failed", "--json", cwd=tmp_path, code=1)
    found = json.loads(retried.stdout)
    assert (found["made"], found["kept"]) == ({"sim": 0}, {"sim": 1})
    assert "action 1" in found["failed"]["sim"]["1"]
    command("validate", "--deep", cwd=tmp_path)
