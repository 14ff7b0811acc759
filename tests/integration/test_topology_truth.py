"""The truth table of the benchmark, simulated and checked."""

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

from doughdata.scene_work import simulate_scene
from doughdata.sim.mpm import MpmSimulator
from doughdata.sim.pull import MpmPullApart
from doughdata.topology.dynamic import DynamicCheck

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def load_table() -> dict[str, Any]:
    """Every case with every seed, from the script beside the benchmark."""
    name = "topology_truth"
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return dict(module.truth_table())


CASES = load_table()


def test_the_table_has_a_half_that_no_threshold_was_chosen_on() -> None:
    """Each half holds at least a third of the cases, and every case has three seeds."""
    halves = [case.half for case in CASES.values()]
    assert set(halves) == {"tuning", "holdout"}
    assert min(halves.count("tuning"), halves.count("holdout")) * 3 >= len(halves)
    seeds: dict[str, set[int]] = {}
    for case in CASES.values():
        seeds.setdefault(case.scene.scene_id, set()).add(case.scene.seed)
    assert all(len(own) >= 3 for own in seeds.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_truth(name: str) -> None:
    """A scene whose outcome anyone would agree on is checked to end that way."""
    case = CASES[name]
    particles = simulate_scene(MpmSimulator(), case.scene)
    topology = DynamicCheck(pull_apart=MpmPullApart()).check(case.scene, particles)
    assert case.right(topology), (case.why, topology.frames[-1].genus, topology.events)
