"""Which scene_index means which scene, and in which shard it lies: an append-only log."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from hashlib import sha256
from typing import Any

from doughdata.dataset.assets import resolve_family, resolve_path, store_family, store_meshes
from doughdata.dataset.documents import dump_document, load_document
from doughdata.dataset.store import Store
from doughdata.scenes import FamilyName, load_family, scene_from_json, scene_to_json
from doughschemas import (
    SCHEMA_VERSION,
    BadInputError,
    DamagedDatasetError,
    DatasetError,
    Scene,
)

__all__ = [
    "PlanRecord",
    "Shard",
    "plan_family",
    "plan_scenes",
    "read_plans",
    "scenes_of",
    "shards_of",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRecord:
    """Scenes that were asked for together (`v1/plan.json`).

    From a family: numbers `first_number .. first_number + count - 1` of (family, split, seed).
    Written by the user: `scenes_path` holds them and `scenes` lists scene_id -> sha256.
    """

    number: int
    family: str | None
    split: str | None
    seed: int | None
    first_number: int
    count: int
    first_scene_index: int
    first_shard: int
    scenes_per_shard: int
    scenes: dict[str, str] | None = None
    scenes_path: str | None = None

    @property
    def name(self) -> str:
        """Path of the record in the dataset."""
        return f"meta/plans/{self.number:05d}.json"

    @property
    def num_shards(self) -> int:
        """Shards that its scenes fill; the last may be short."""
        return -(-self.count // self.scenes_per_shard)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """The unit of work, commit and retry: consecutive scenes of one plan record."""

    id: str  # "00000"
    plan: int
    scene_indices: tuple[int, ...]


def read_plans(store: Store) -> list[PlanRecord]:
    """All plan records, in order.

    Raises:
        DamagedDatasetError: a record is missing, changed or does not follow its forerunner.
    """
    plans: list[PlanRecord] = []
    for name in store.names("meta/plans"):
        where = f"{store.uri}: meta/plans/{name}"
        document = load_document(store.read(f"meta/plans/{name}"), name=where)
        known = {field.name for field in fields(PlanRecord)}
        try:
            plan = PlanRecord(**{name: document[name] for name in known & {*document}})
        except TypeError as error:
            raise DamagedDatasetError(f"{where}: not a plan record ({error})") from error
        starts = (len(plans), *_next(plans))
        if (plan.number, plan.first_scene_index, plan.first_shard) != starts:
            raise DamagedDatasetError(f"{where}: does not follow the record before it")
        plans.append(plan)
    return plans


def plan_family(
    store: Store, family: str, *, split: str, seed: int, count: int, scenes_per_shard: int
) -> list[Shard]:
    """Make sure that scenes 0..count-1 of a family are planned; returns all its planned shards.

    Raises:
        DatasetError: one of the new scenes is there already, written out as a user's scene is: a
            subset or a merge took it from a dataset in which it was sampled.
    """
    if count < 0:
        raise BadInputError(f"the number of scenes must be 0 or more, got {count}")
    family = store_family(store, family)
    while True:
        plans = read_plans(store)
        mine = [p for p in plans if (p.family, p.split, p.seed) == (family, split, seed)]
        have = sum(p.count for p in mine)
        if have >= count:
            return [shard for plan in mine for shard in shards_of(plan)]
        first_scene_index, first_shard = _next(plans)
        plan = PlanRecord(
            number=len(plans),
            family=family,
            split=split,
            seed=seed,
            first_number=have,
            count=count - have,
            first_scene_index=first_scene_index,
            first_shard=first_shard,
            scenes_per_shard=scenes_per_shard,
        )
        written = {name for other in plans for name in (other.scenes or {})}
        if written:
            numbers = range(have, count)
            double = [s.scene_id for s in _sampled(store, plan, numbers) if s.scene_id in written]
            if double:
                raise DatasetError(
                    f"{store.uri}: scene {double[0]!r} of this family, split and seed is in the "
                    "dataset already, taken from another one; give another --seed"
                )
        _append(store, plan)  # another process may be faster: then look again


def plan_scenes(store: Store, scenes: Sequence[Scene], *, scenes_per_shard: int) -> list[Shard]:
    """Make sure that these user-written scenes are planned; returns the shards that hold them.

    Raises:
        DatasetError: another scene of the same scene_id is in the dataset already.
    """
    texts = {
        s.scene_id: json.dumps(scene_to_json(store_meshes(store, s)), indent=1) for s in scenes
    }
    hashes = {scene_id: sha256(text.encode()).hexdigest() for scene_id, text in texts.items()}
    while True:
        plans = read_plans(store)
        known = {k: v for plan in plans for k, v in (plan.scenes or {}).items()}
        clash = [i for i in hashes if i in known and known[i] != hashes[i]]
        clash += sorted(set(hashes) & _sampled_ids(store, plans, scenes))
        if clash:
            raise DatasetError(
                f"{store.uri}: another scene {clash[0]!r} is in this dataset already; "
                "give yours a scene_id of its own"
            )
        new = {scene_id: text for scene_id, text in texts.items() if scene_id not in known}
        if not new:
            mine = [plan for plan in plans if plan.scenes and set(plan.scenes) & set(hashes)]
            return [shard for plan in mine for shard in shards_of(plan)]
        data = ("[" + ",\n".join(new.values()) + "]\n").encode()
        path = f"meta/scenes/{sha256(data).hexdigest()}.json"
        store.create(path, data)
        first_scene_index, first_shard = _next(plans)
        plan = PlanRecord(
            number=len(plans),
            family=None,
            split=None,
            seed=None,
            first_number=0,
            count=len(new),
            first_scene_index=first_scene_index,
            first_shard=first_shard,
            scenes_per_shard=scenes_per_shard,
            scenes={scene_id: hashes[scene_id] for scene_id in new},
            scenes_path=path,
        )
        _append(store, plan)


def shards_of(plan: PlanRecord) -> list[Shard]:
    """Shards of one plan record."""
    shards = []
    for k in range(plan.num_shards):
        start = k * plan.scenes_per_shard
        stop = min(start + plan.scenes_per_shard, plan.count)
        indices = range(plan.first_scene_index + start, plan.first_scene_index + stop)
        shard = f"{plan.first_shard + k:05d}"
        shards.append(Shard(id=shard, plan=plan.number, scene_indices=tuple(indices)))
    return shards


def scenes_of(store: Store, plan: PlanRecord, indices: Iterable[int]) -> dict[int, Scene]:
    """The scenes themselves, scene_index -> Scene: sampled from the family, or read back."""
    if plan.family is not None:
        first, indices = plan.first_number - plan.first_scene_index, list(indices)
        return dict(zip(indices, _sampled(store, plan, (first + i for i in indices)), strict=True))
    entries: list[Any] = json.loads(store.read(plan.scenes_path or ""))
    locate = partial(resolve_path, store)
    return {i: scene_from_json(entries[i - plan.first_scene_index], locate=locate) for i in indices}


def _next(plans: Sequence[PlanRecord]) -> tuple[int, int]:
    return sum(plan.count for plan in plans), sum(plan.num_shards for plan in plans)


def _append(store: Store, plan: PlanRecord) -> bool:
    return store.create(
        plan.name, dump_document({"schema_version": SCHEMA_VERSION, **asdict(plan)})
    )


def _sampled_ids(store: Store, plans: Sequence[PlanRecord], scenes: Sequence[Scene]) -> set[str]:
    """Ids that families gave, where a user's scene could have the same one."""
    wanted = {(scene.family, scene.split, scene.seed) for scene in scenes}
    ids = set()
    for plan in plans:
        if plan.family is None:
            continue
        if (FamilyName.parse(plan.family).name, plan.split, plan.seed) in wanted:
            numbers = range(plan.first_number, plan.first_number + plan.count)
            ids.update(scene.scene_id for scene in _sampled(store, plan, numbers))
    return ids


def _sampled(store: Store, plan: PlanRecord, numbers: Iterable[int]) -> Iterator[Scene]:
    """Scenes of a plan that came from a family, by their number in it."""
    assert plan.family is not None
    assert plan.seed is not None
    assert plan.split is not None
    family = load_family(resolve_family(store, plan.family))
    for number in numbers:
        yield family.sample(seed=plan.seed, number=number, split=plan.split)
