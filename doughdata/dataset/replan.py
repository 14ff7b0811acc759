"""Plans of a dataset that takes chosen scenes from others: which scene_index and shard each gets.

Shards stay apart: one that loses scenes becomes smaller. Scenes of a family stay a plan of that
family where their numbers go on from what the new dataset has of it, so that `generate` can extend
it; all others are written out, as a user's scenes are.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import Any

from doughdata.dataset.commits import CommitLog
from doughdata.dataset.plan import PlanRecord, Shard, read_plans, shards_of
from doughdata.dataset.reader import Dataset
from doughdata.dataset.shard_copy import ShardCopy
from doughdata.dataset.store import Store

__all__ = ["Part", "Placement", "replan"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Scenes that are taken from one dataset."""

    dataset: Dataset
    store: Store
    log: CommitLog
    plans: Sequence[PlanRecord]
    scenes: frozenset[int]  # scene_index of what is taken; planned scenes may be taken, too
    splits: Mapping[int, str] = field(default_factory=dict)  # of scenes that change their split

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        store: Store,
        *,
        scenes: Sequence[int] | None = None,
        splits: Mapping[int, str] | None = None,
    ) -> "Part":
        """Some scenes of a dataset, or all that are planned."""
        plans = read_plans(store)
        taken = range(sum(plan.count for plan in plans)) if scenes is None else scenes
        return cls(
            dataset=dataset,
            store=store,
            log=CommitLog(store),
            plans=plans,
            scenes=frozenset(taken),
            splits=splits or {},
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """One plan record of the new dataset and the shards that fill it."""

    plan: PlanRecord
    texts: bytes | None  # content of `plan.scenes_path`, for scenes that are written out
    copies: tuple[ShardCopy, ...]
    part: int  # number of the part that the shards come from


def replan(parts: Sequence[Part]) -> list[Placement]:
    """Place the parts one after the other, in the order of their scenes."""
    planner = _Planner()
    for number, part in enumerate(parts):
        for plan in part.plans:
            for run in _runs(part, plan):
                planner.place(number, part, plan, run)
    return planner.placements


class _Planner:
    """Counts what is placed so far."""

    def __init__(self) -> None:
        self.placements: list[Placement] = []
        self._scenes = self._shards = 0
        self._numbers: Counter[tuple[Any, ...]] = Counter()  # scenes of a family, split and seed

    def place(self, number: int, part: Part, plan: PlanRecord, run: list[Shard]) -> None:
        """Append a record for a run of shards of one source plan."""
        old = [index for shard in run for index in shard.scene_indices]
        new = {index: self._scenes + k for k, index in enumerate(old)}
        record, texts = self._record(part, plan, old, size=len(run[0].scene_indices))
        copies = (
            ShardCopy(
                store=part.store,
                num_frames=part.dataset.num_frames,
                source=shard.id,
                target=f"{self._shards + k:05d}",
                scenes={index: new[index] for index in shard.scene_indices},
                splits=part.splits,
            )
            for k, shard in enumerate(run)
        )
        self.placements.append(
            Placement(plan=record, texts=texts, copies=tuple(copies), part=number)
        )
        self._scenes += len(old)
        self._shards += len(run)

    def _record(
        self, part: Part, plan: PlanRecord, old: Sequence[int], *, size: int
    ) -> tuple[PlanRecord, bytes | None]:
        place: dict[str, Any] = {
            "number": len(self.placements),
            "count": len(old),
            "first_scene_index": self._scenes,
            "first_shard": self._shards,
            "scenes_per_shard": size,
        }
        if plan.family and plan.seed is None:  # a recording: one scene, known by its digest
            return replace(plan, **place), None
        key = (plan.family, plan.split, plan.seed)
        first = plan.first_number + old[0] - plan.first_scene_index
        if plan.family and old[-1] - old[0] == len(old) - 1 and first == self._numbers[key]:
            self._numbers[key] += len(old)
            names = {"family": plan.family, "split": plan.split, "seed": plan.seed}
            return PlanRecord(**place, **names, first_number=first), None
        texts = {scene["scene_id"]: json.dumps(scene, indent=1) for scene in _scenes(part, old)}
        data = ("[" + ",\n".join(texts.values()) + "]\n").encode()
        record = PlanRecord(
            **place,
            family=None,
            split=None,
            seed=None,
            first_number=0,
            scenes={name: sha256(text.encode()).hexdigest() for name, text in texts.items()},
            scenes_path=f"meta/scenes/{sha256(data).hexdigest()}.json",
        )
        return record, data


def _runs(part: Part, plan: PlanRecord) -> Iterator[list[Shard]]:
    """Shards of a plan that one record can describe: of one size, the last may be smaller."""
    run: list[Shard] = []
    for shard in shards_of(plan):
        taken = tuple(index for index in shard.scene_indices if index in part.scenes)
        if not taken:
            continue
        if run and not len(run[0].scene_indices) == len(run[-1].scene_indices) >= len(taken):
            yield run
            run = []
        run.append(Shard(id=shard.id, plan=plan.number, scene_indices=taken))
    if run:
        yield run


def _scenes(part: Part, indices: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Plain JSON of scenes, as the dataset stores them."""
    table = part.dataset.scenes
    made = dict(zip(table["scene_index"].to_pylist(), table["parameters"].to_pylist(), strict=True))
    for index in indices:
        if index in made:
            yield json.loads(made[index])
        else:  # planned by a user, not simulated
            plan = next(p for p in part.plans if 0 <= index - p.first_scene_index < p.count)
            entries = json.loads(part.store.read(plan.scenes_path or ""))
            yield entries[index - plan.first_scene_index]
