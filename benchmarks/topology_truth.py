"""The truth table: scenes whose outcome anyone would agree on (`truth_table.json`), played out.

Each scene stands away from every threshold and is played with several particle seeds. Thresholds
were chosen on the half `tuning` alone; the half `holdout` shows that they hold elsewhere. A case
with the verdict `right or ambiguous` has an arguable outcome: the check may also say that it is
unsure, but must not be sure of something else.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from doughdata.scenes.json import scene_from_json
from doughschemas import Scene, Topology

__all__ = ["SEEDS", "Case", "truth_table"]

SEEDS = (0, 1, 2)  # of the particles' jitter
FILE = Path(__file__).with_name("truth_table.json")


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A scene with its outcome."""

    scene: Scene
    genus: list[int]  # of every component in the last key frame, rising
    half: str  # tuning | holdout
    may_doubt: bool
    why: str

    def right(self, topology: Topology) -> bool:
        """Whether the check found the outcome, or is unsure where it may be."""
        last = topology.frames[-1]
        return sorted(last.genus) == self.genus or (self.may_doubt and last.ambiguous)


def truth_table(seeds: tuple[int, ...] = SEEDS) -> Iterator[tuple[str, Case]]:
    """Every case with every seed, by name."""
    entries: list[dict[str, Any]] = json.loads(FILE.read_text())
    for entry in entries:
        scene = scene_from_json(entry["scene"])
        for seed in seeds:
            case = Case(
                scene=replace(scene, seed=seed),
                genus=entry["genus"],
                half=entry["half"],
                may_doubt=entry["verdict"] != "right",
                why=entry["why"],
            )
            yield f"{scene.scene_id} (seed {seed})", case
