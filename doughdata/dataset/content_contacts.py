"""What the contact columns of `frames` must satisfy: they are what the layers give."""

from collections.abc import Iterator
from typing import Any

from doughdata.dataset.completion import computed_columns
from doughdata.dataset.report import Problem
from doughdata.dataset.shards import LayerShard
from doughdata.dataset.store import Store

__all__ = ["contact_problems"]

SLACK, SHARE = 2, 0.01  # particles, or a share of them, that rounding may count otherwise


def contact_problems(store: Store, shard: LayerShard, sim: LayerShard) -> Iterator[Problem]:
    """Problems of a layer `sim` or `topology`; none if nobody computed its contacts yet.

    Raises:
        DamagedDatasetError: the table, its supplement or what it is computed from is damaged.
        MissingPackageError: a mesh tool needs trimesh and Open3D.
    """
    table = shard.frames_with_contacts().table
    expected = computed_columns(store, shard, sim)
    keys = list(zip(*(table[c].to_pylist() for c in ("scene_index", "frame_index")), strict=True))
    told = {name: table[name].to_pylist() for name in expected}
    if "tool_contact" in expected:  # what the stored counts say, not those that may differ a little
        expected["tool_contact"] = [
            None if counts is None else any(counts) for counts in told["finger_contacts"]
        ]
    for name, values in expected.items():
        stored = told[name]
        if all(value is None for value in stored):
            continue
        wrong = [
            key for key, a, b in zip(keys, stored, values, strict=True) if not _agree(name, a, b)
        ]
        if wrong:
            message = f"{name} is not what the particles and labels give"
            file = f"{shard.commit.path}/frames.parquet"
            yield Problem(file=file, message=message, frames=tuple(wrong))


def _agree(name: str, stored: Any, computed: Any) -> bool:
    """Equal; counts of particles may differ a little, as machines round differently."""
    if stored is None or computed is None:
        return stored is computed
    if name == "finger_contacts":
        return len(stored) == len(computed) and all(map(_near, stored, computed))
    if name == "table_contacts":
        return _near(stored, computed)
    return stored == computed


def _near(stored: int, computed: int) -> bool:
    return abs(stored - computed) <= max(SLACK, SHARE * computed)
