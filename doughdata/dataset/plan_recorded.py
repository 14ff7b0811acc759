"""Places for recordings: a plan record of its own for each."""

from dataclasses import asdict

from doughdata.dataset.documents import dump_document
from doughdata.dataset.layers.recorded import RECORDED_FAMILY
from doughdata.dataset.plan import PlanRecord, Shard, read_plans, shards_of
from doughdata.dataset.store import Store
from doughschemas import SCHEMA_VERSION

__all__ = ["find_recording", "plan_recording"]


def find_recording(store: Store, digest: str) -> tuple[str, Shard] | None:
    """scene_id and shard of a recording (hex sha256) that has a place already."""
    for plan in read_plans(store):
        if plan.family == RECORDED_FAMILY and plan.scenes:
            ((scene_id, known),) = plan.scenes.items()
            if known == digest:
                return scene_id, shards_of(plan)[0]
    return None


def plan_recording(store: Store, scene_id: str, digest: str) -> tuple[str, Shard]:
    """Give a recording a place, once; returns its scene_id and shard.

    A name that another scene has already gets the beginning of the digest behind it.
    """
    while True:
        found = find_recording(store, digest)
        if found is not None:
            return found
        plans = read_plans(store)
        taken = {name for plan in plans for name in (plan.scenes or {})}
        name = scene_id if scene_id not in taken else f"{scene_id}-{digest[:8]}"
        plan = PlanRecord(
            number=len(plans),
            family=RECORDED_FAMILY,
            split=None,
            seed=None,
            first_number=0,
            count=1,
            first_scene_index=sum(plan.count for plan in plans),
            first_shard=sum(plan.num_shards for plan in plans),
            scenes_per_shard=1,
            scenes={name: digest},
        )
        # Another process may have taken the number meanwhile: then it is looked up again.
        store.create(plan.name, dump_document({"schema_version": SCHEMA_VERSION, **asdict(plan)}))
