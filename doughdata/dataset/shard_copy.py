"""One committed layer of one shard as it stands in another dataset: renumbered, maybe fewer scenes.

Arrays hold no scene_index, so a shard that keeps all its scenes keeps the very bytes of its arrays.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np
import pyarrow as pa

from doughdata.dataset.arrays import ArraySpec, ShardedArray, encode_arrays
from doughdata.dataset.commits import CommitRecord
from doughdata.dataset.completion import completed
from doughdata.dataset.contacts import CONTACT_COLUMNS
from doughdata.dataset.shards import ARRAYS, encode_table, read_table
from doughdata.dataset.store import Store
from doughschemas import DamagedDatasetError

__all__ = ["ShardCopy", "copied_commit", "copied_files"]

GROUP = f"{ARRAYS}/zarr.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardCopy:
    """What becomes of a shard."""

    store: Store  # where it comes from
    num_frames: int
    source: str  # its id there
    target: str  # its id in the new dataset
    scenes: Mapping[int, int]  # scene_index there -> scene_index here; both rise
    splits: Mapping[int, str]  # scene_index there -> split here, of scenes that change theirs


def copied_commit(
    copy: ShardCopy, commit: CommitRecord, upstream: Mapping[str, str]
) -> CommitRecord | None:
    """The record of a copied layer, still without its files; None if no chosen scene is in it.

    Args:
        copy: which scenes, and where they go.
        commit: of the source.
        upstream: layer -> hash of the copied commit.
    """
    scenes = tuple(copy.scenes[i] for i in commit.scenes if i in copy.scenes)
    failed = {copy.scenes[i]: why for i, why in commit.failed.items() if i in copy.scenes}
    if not scenes and not failed:
        return None
    return replace(
        commit,
        shard=copy.target,
        revision=0,
        path=None,
        files={},
        scenes=scenes,
        failed=failed,
        upstream={layer: upstream[layer] for layer in commit.upstream},
        hash="",
    )


def copied_files(
    copy: ShardCopy, commit: CommitRecord, base: CommitRecord, new: CommitRecord
) -> dict[str, bytes]:
    """Content of the attempt folder: name -> bytes. Every source file is checked first.

    Args:
        copy: which scenes, and where they go.
        commit: of the source's layer.
        base: the commit of the source that its rows follow: `sim` where there is one.
        new: from `copied_commit`.

    Raises:
        DamagedDatasetError: a file of the source is missing or has changed.
    """
    files = {name: _verified(copy.store, commit, name) for name in commit.files}
    tables = {name: data for name, data in files.items() if name.endswith(".parquet")}
    new_tables = {name: _table(copy, commit, base, name) for name in tables}
    attributes = {"layer": new.layer, "shard": new.shard, "scenes": list(new.scenes)}
    if all(index in copy.scenes for index in {*base.scenes, *commit.scenes}):
        arrays = {name: data for name, data in files.items() if name not in tables}
        arrays[GROUP] = _group(arrays[GROUP], attributes)
    else:
        encoded = encode_arrays(_arrays(copy, commit, base), attributes=attributes)
        arrays = {f"{ARRAYS}/{name}": data for name, data in encoded.items()}
    return {
        **arrays,
        **{name: encode_table(table, parts=True) for name, table in new_tables.items()},
    }


def _verified(store: Store, commit: CommitRecord, name: str) -> bytes:
    path = f"{commit.path}/{name}"
    data = store.read(path)
    if sha256(data).hexdigest() != commit.files[name]:
        raise DamagedDatasetError(
            f"{store.uri}: {path} has changed since it was written (sha256); "
            f"`doughdata validate --deep --dataset {store.uri}` says which key frames it hits"
        )
    return data


def _group(data: bytes, attributes: Mapping[str, Any]) -> bytes:
    """The metadata of a Zarr group with other attributes."""
    group = json.loads(data)
    return json.dumps({**group, "attributes": {**group["attributes"], **attributes}}).encode()


def _table(copy: ShardCopy, commit: CommitRecord, base: CommitRecord, name: str) -> pa.Table:
    """The rows of the chosen scenes, renumbered, with the columns of the newest version."""
    table = read_table(copy.store, f"{commit.path}/{name}")
    if name == "frames.parquet" and commit.layer in CONTACT_COLUMNS:
        table = completed(copy.store, commit, base, table, num_frames=copy.num_frames)
    if "scene_index" not in table.column_names:
        return table
    old = table["scene_index"].to_numpy()
    table = table.filter(pa.array(np.isin(old, list(copy.scenes))))
    kept = table["scene_index"].to_pylist()
    table = _with_column(table, "scene_index", [copy.scenes[index] for index in kept])
    if name == "scenes.parquet" and copy.splits:
        splits = zip(kept, table["split"].to_pylist(), strict=True)
        table = _with_column(table, "split", [copy.splits.get(i, s) for i, s in splits])
    if "row" in table.column_names:  # of the arrays, which lose the same rows
        table = _with_column(table, "row", list(range(len(table))))
    return table


def _with_column(table: pa.Table, name: str, values: list) -> pa.Table:
    place = table.schema.get_field_index(name)
    column = pa.array(values, table.schema.field(name).type)
    return table.set_column(place, name, column)


def _arrays(copy: ShardCopy, commit: CommitRecord, base: CommitRecord) -> dict[str, ArraySpec]:
    """Every array with the rows of the chosen scenes, as wide as before."""
    names = {n.split("/")[1] for n in commit.files if n.startswith(f"{ARRAYS}/") and n != GROUP}
    rows: dict[str, np.ndarray] = {}
    arrays = {}
    for name in sorted(names):
        path = f"{commit.path}/{ARRAYS}/{name}"
        array = ShardedArray(path, store=copy.store)
        axis = array.axes[0]
        if axis not in rows:
            rows[axis] = _rows(copy, commit, base, axis)
        meta = json.loads(copy.store.read(f"{path}/zarr.json"))
        arrays[name] = _spec(array, meta, rows[axis])
    return arrays


def _rows(copy: ShardCopy, commit: CommitRecord, base: CommitRecord, axis: str) -> np.ndarray:
    """Rows of the chosen scenes along the first axis of an array: views, or key frames."""
    if axis == "view":
        views = read_table(copy.store, f"{commit.path}/views.parquet")
        return np.flatnonzero(np.isin(views["scene_index"].to_numpy(), list(copy.scenes)))
    kept = np.isin(base.scenes, list(copy.scenes))
    return np.flatnonzero(np.repeat(kept, copy.num_frames))


def _spec(array: ShardedArray, meta: Mapping[str, Any], rows: np.ndarray) -> ArraySpec:
    """Some rows of an array, to be written like the whole."""
    chunk = meta["chunk_grid"]["configuration"]["chunk_shape"]
    for codec in meta["codecs"]:
        chunk = codec.get("configuration", {}).get("chunk_shape", chunk)
    fill = meta["fill_value"]
    shape = (len(rows), *array.shape[1:])
    parts = [array.row(int(row)) for row in rows]
    return ArraySpec(
        data=np.stack(parts) if parts else np.zeros(shape, array.dtype),
        axes=array.axes,
        fill=float(fill) if isinstance(fill, str) else fill,
        by_row=chunk[0] == 1,
        attributes=array.attributes,
    )
