"""The dynamic check: its share of right answers on scenes with a known end, and its cost.

Scenes are those of the truth table whose outcome anyone would agree on. `--full` runs all of them,
the default the quick ones. CPU seconds are of one process.
"""

import argparse
import json
import math
import time

import numpy as np

from doughdata.scenes.tools import PRESETS
from doughdata.sim.mpm import MpmSimulator
from doughdata.sim.pull import MpmPullApart
from doughdata.topology.dynamic import DynamicCheck
from doughschemas import Action, Body, Scene

NARROW, REGULAR, WIDE = (PRESETS[name] for name in ("narrow", "regular", "wide"))


def roll(x: float) -> Body:
    """A roll of 10 mm radius and 60 mm length."""
    return Body(shape="roll", parameters={"radius": 0.010, "length": 0.060}, position=(x, 0.0))


def ring() -> Body:
    """A doughnut of 22.5 mm radius and 8.5 mm tube radius."""
    return Body(shape="ring", parameters={"ring_radius": 0.0225, "tube_radius": 0.0085})


def scene(name: str, bodies: list[Body], tools: list, *actions: Action) -> Scene:
    """A scene of the table."""
    return Scene(
        scene_id=name,
        family="truth",
        region="custom",
        bodies=tuple(bodies),
        tools=tuple(tools),
        actions=actions,
    )


def squeeze(start: float, end: float, **rest) -> Action:
    """A squeeze between two openings [m]."""
    return Action(opening_start=start, opening_end=end, **rest)


def truth_table() -> dict[str, tuple[Scene, list[int], bool]]:
    """Scene, final genus of every component, and whether it belongs to the quick set."""
    two, close = [roll(-0.0125), roll(0.0125)], [roll(-0.011), roll(0.011)]
    again = squeeze(0.084, 0.044, yaw=math.pi / 2, tool=1)
    cut = squeeze(0.030, 0.001, release=True)
    turned = squeeze(0.064, 0.005, yaw=math.radians(37))
    return {
        "apart": (scene("apart", two, [REGULAR], squeeze(0.066, 0.061)), [0, 0], True),
        "touching": (scene("touching", two, [WIDE], squeeze(0.047, 0.0385)), [0, 0], True),
        "merged": (scene("merged", close, [REGULAR], squeeze(0.048, 0.012)), [0], True),
        "cut": (scene("cut", [roll(0.0)], [NARROW], squeeze(0.040, 0.001)), [0, 0], True),
        "arc": (
            scene("arc", [ring()], [NARROW], squeeze(0.024, 0.001, position=(0.0225, 0.0))),
            [0],
            True,
        ),
        "eight": (scene("eight", [ring()], [REGULAR], squeeze(0.064, 0.005)), [2], True),
        "two rings": (scene("two rings", [ring()], [REGULAR], squeeze(0.064, 0.001)), [1, 1], True),
        "walls": (scene("walls", [ring()], [REGULAR], squeeze(0.064, 0.0105)), [1], False),
        "turned": (scene("turned", [ring()], [REGULAR], turned), [2], False),
        "again": (scene("again", [roll(0.0)], [NARROW, WIDE], cut, again), [0], False),
    }


def measure(*, full: bool) -> dict[str, object]:
    """Run the table; the default doughnut is the figure eight."""
    check, simulator = DynamicCheck(pull_apart=MpmPullApart()), MpmSimulator()
    right: dict[str, bool] = {}
    seconds: dict[str, tuple[float, float]] = {}
    frames = unsure = 0
    cases = {n: case for n, case in truth_table().items() if full or case[2]}
    warm = cases["merged"][0]  # once before, so that no compilation is counted
    check.check(warm, simulator.simulate(warm, rng=np.random.default_rng(0)))
    for name, (case, genus, _) in cases.items():
        start = time.process_time()
        particles = simulator.simulate(case, rng=np.random.default_rng(0))
        middle = time.process_time()
        topology = check.check(case, particles)
        frames += len(topology.frames)
        unsure += sum(frame.ambiguous for frame in topology.frames)
        seconds[name] = (middle - start, time.process_time() - middle)
        right[name] = sorted(topology.frames[-1].genus) == genus
    simulated, checked = np.sum(list(seconds.values()), axis=0)
    return {
        "truth_table": sum(right.values()) / len(right),
        "wrong": [name for name, ok in right.items() if not ok],
        "ambiguous": unsure / frames,
        "check_cpu_s": round(seconds["eight"][1], 2),
        "check_share": round(float(checked / simulated), 3),
    }


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    parser.add_argument("--full", action="store_true", help="every scene of the table")
    options = parser.parse_args()
    result = measure(full=options.full)
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
