"""The contact columns of a committed layer, computed from what the dataset holds."""

from functools import partial
from json import loads
from typing import Any

import pyarrow as pa

from doughdata.dataset.assets import resolve_path
from doughdata.dataset.commits import CommitRecord
from doughdata.dataset.contacts import contact_arrays, particle_contacts, piece_contacts
from doughdata.dataset.layers import decode_frame_topology, decode_particles
from doughdata.dataset.shards import LayerShard, ShardRows
from doughdata.dataset.store import Store
from doughdata.dataset.supplements import has_contacts, read_supplement, supplement_arrays
from doughdata.scenes import scene_from_json

__all__ = ["completed", "computed_columns"]


def completed(
    store: Store, commit: CommitRecord, sim: CommitRecord, table: pa.Table, *, num_frames: int
) -> pa.Table:
    """The table `frames` of a commit with contact columns, computed if nobody has done so yet.

    Raises as `computed_columns` does.
    """
    if has_contacts(commit.layer, table):
        return table
    supplement = read_supplement(store, commit)
    if supplement is None:
        rows = ShardRows(scenes=sim.scenes, num_frames=num_frames)
        shard, base = LayerShard(store, commit, rows), LayerShard(store, sim, rows)
        arrays = contact_arrays(commit.layer, computed_columns(store, shard, base))
    else:
        arrays = supplement_arrays(store, commit, supplement, rows=len(table))
    for name, values in arrays.items():
        table = table.append_column(name, values)
    return table


def computed_columns(store: Store, shard: LayerShard, sim: LayerShard) -> dict[str, list[Any]]:
    """Columns that format 1.1 adds to the table `frames` of a layer, from what the layers hold.

    Args:
        store: of the dataset.
        shard: layer `sim` or `topology`.
        sim: the layer `sim` of the same shard.

    Raises:
        DamagedDatasetError: a byte that is needed has changed.
        MissingPackageError: a mesh tool needs trimesh and Open3D.
    """
    layer, columns = shard.commit.layer, dict[str, list[Any]]()
    for index in shard.commit.scenes:
        if layer == "sim":
            text = shard.table("scenes").scene(index)["parameters"][0].as_py()
            locate = partial(resolve_path, store)
            scene = scene_from_json(loads(text), locate=locate, stored=True)
            found = particle_contacts(decode_particles(shard, index), scene)
        else:
            count = int(sim.array("num_particles").row(sim.rows.start(index)))
            found = piece_contacts(
                decode_frame_topology(shard, index, frame, num_particles=count)
                for frame in range(shard.rows.num_frames)
            )
        for name, values in found.items():
            columns.setdefault(name, []).extend(values)
    return columns
