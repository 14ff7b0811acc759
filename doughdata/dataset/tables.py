"""Derived tables: rebuilt from the commits at any time, replaced one by one, each atomically."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
import pyarrow as pa

from doughdata.dataset.commits import RECORDED, CommitLog, CommitRecord
from doughdata.dataset.contacts import CONTACT_COLUMNS
from doughdata.dataset.describe import Features, describe
from doughdata.dataset.info import features_of, read_info, refuse_newer, write_info
from doughdata.dataset.shards import encode_table, read_table
from doughdata.dataset.store import Store
from doughdata.dataset.supplements import with_contacts
from doughschemas import DamagedDatasetError

__all__ = [
    "TABLES",
    "build_info",
    "build_tables",
    "fingerprint_of",
    "refresh_tables",
    "table_schemas",
]

INDEX = [
    ("scene_index", pa.int64()),
    ("frame_index", pa.int32()),
    ("index", pa.int64()),
    ("timestamp", pa.float64()),
]
INTS = pa.list_(pa.int32())
TOPOLOGY_COLUMNS = [
    ("num_components", pa.int32()),
    ("genus", INTS),
    ("ambiguous", pa.bool_()),
    ("ambiguous_reason", pa.string()),
    ("static_num_components", pa.int32()),
    ("static_genus", INTS),
]
POSE = [("position", pa.list_(pa.float64(), 3)), ("quaternion", pa.list_(pa.float64(), 4))]
SINCE_1_1 = {name for columns in CONTACT_COLUMNS.values() for name, _ in columns}
TABLES = {  # name -> columns of the newest version; SPEC.md says what they mean
    "scenes": [
        ("scene_index", pa.int64()),
        ("scene_id", pa.string()),
        ("family", pa.string()),
        ("split", pa.string()),
        ("region", pa.string()),
        ("seed", pa.int64()),
        ("shard", pa.string()),
        ("num_frames", pa.int32()),
        ("duration", pa.float64()),
        ("num_particles", pa.int32()),
        ("particle_spacing", pa.float64()),
        ("num_bodies", pa.int32()),
        ("num_actions", pa.int32()),
        ("tools", pa.list_(pa.string())),
        ("failed", pa.string()),
        ("parameters", pa.string()),
    ],
    "frames": [
        *INDEX,
        ("shard", pa.string()),
        ("row", pa.int64()),
        ("num_particles", pa.int32()),
        ("opening", pa.float64()),
        ("action", pa.int32()),
        *TOPOLOGY_COLUMNS,
        *CONTACT_COLUMNS["sim"],
        *CONTACT_COLUMNS["topology"],
    ],
    "topology_events": [
        *INDEX,
        ("kind", pa.string()),
        ("components_before", INTS),
        ("components_after", INTS),
        ("margin", pa.float64()),
    ],
    "graph_nodes": [
        *INDEX,
        ("node", pa.int32()),
        ("component", pa.uint8()),
        ("position", pa.list_(pa.float32(), 3)),
        ("particles", pa.int32()),
    ],
    "graph_edges": [*INDEX, ("a", pa.int32()), ("b", pa.int32())],
    "tool_poses": [
        *INDEX,
        ("body", pa.int32()),
        *POSE,
        ("opening", pa.float64()),
        ("action", pa.int32()),
    ],
    "views": [
        *INDEX,
        ("layer", pa.string()),
        ("shard", pa.string()),
        ("row", pa.int64()),
        ("view_index", pa.int32()),
        *POSE,
        ("width", pa.int32()),
        ("height", pa.int32()),
        *((name, pa.float64()) for name in ("fx", "fy", "cx", "cy")),
    ],
}
Parts = dict[str, list[pa.Table]]
Times = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (scene_index, frame_index) -> [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shard:
    """What the tables of one shard are made from."""

    store: Store
    id: str
    commits: Mapping[str, CommitRecord]
    num_frames: int
    schemas: Mapping[str, pa.Schema]  # of the derived tables

    def table(self, layer: str, name: str) -> pa.Table | None:
        """A table of a committed attempt, or None if the layer has none."""
        commit = self.commits.get(layer)
        if commit is None or commit.path is None:
            return None
        table = read_table(self.store, f"{commit.path}/{name}.parquet")
        if name == "frames" and "tool_contact" in self.schemas["frames"].names:
            return with_contacts(self.store, commit, table)
        return table


def refresh_tables(
    store: Store,
    *,
    arrays: Features | None = None,
    license_name: str | None = None,
    version: str | None = None,
) -> dict[str, Any]:
    """Rebuild all tables, what describes them, and the totals in info.json; returns the info.

    `arrays` and `license_name` as for `describe`. The dataset keeps its schema version, which says
    what columns the tables have, unless `version` raises it.

    Raises:
        VersionError: a newer release made the dataset.
        DamagedDatasetError: a commit record or a table of an attempt is damaged.
        DatasetError: the disk is full or read-only.
    """
    info, log = read_info(store), CommitLog(store)
    refuse_newer(store.uri, info)
    info = {**info, "schema_version": version or info["schema_version"]}
    tables = build_tables(store, log, info)
    hashes = {}
    for name, table in tables.items():
        data = encode_table(table, version=info["schema_version"])
        hashes[name] = sha256(data).hexdigest()
        store.replace(f"meta/{name}.parquet", data)
    info = build_info(info, log, tables, hashes)
    documents = describe(store, info, tables, arrays=arrays, license_name=license_name)
    info = {**info, "documents": documents}
    write_info(store, info)
    return info


def table_schemas(version: str) -> dict[str, pa.Schema]:
    """Table -> columns of a schema version, which stands in the metadata."""
    left_out = SINCE_1_1 if version == "1.0" else frozenset()
    return {
        name: pa.schema(
            [column for column in columns if column[0] not in left_out],
            metadata={"schema_version": version},
        )
        for name, columns in TABLES.items()
    }


def build_tables(store: Store, log: CommitLog, info: Mapping[str, Any]) -> dict[str, pa.Table]:
    """All derived tables, sorted by scene_index and frame_index. Raises as `refresh_tables`."""
    parts: Parts = {name: [] for name in TABLES}
    schemas = table_schemas(info["schema_version"])
    for shard_id in log.shards:
        commits = log.fresh(shard_id)
        shard = _Shard(
            store=store,
            id=shard_id,
            commits=commits,
            num_frames=info["num_frames"],
            schemas=schemas,
        )
        try:
            _add_shard(parts, shard)
        except (LookupError, ValueError, pa.ArrowException) as error:  # a column is gone
            raise DamagedDatasetError(
                f"{store.uri}: the tables of shard {shard_id} are damaged ({error})"
            ) from error
    return {name: _joined(name, tables, schemas[name]) for name, tables in parts.items()}


def build_info(
    info: Mapping[str, Any],
    log: CommitLog,
    tables: Mapping[str, pa.Table],
    hashes: Mapping[str, str],
) -> dict[str, Any]:
    """The info with totals, splits, features, stages and fingerprint brought up to date."""
    commits = [commit for shard in log.shards for commit in log.fresh(shard).values()]
    stages = {commit.layer: commit.stage.to_json() for commit in commits}
    scenes = tables["scenes"]
    counts, lengths = Counter(scenes["split"].to_pylist()), Counter()
    for split, length in zip(
        scenes["split"].to_pylist(), scenes["num_frames"].to_pylist(), strict=True
    ):
        lengths[split] += length
    splits = {
        split: {"scenes": count, "frames": lengths[split]}
        for split, count in sorted(counts.items())
    }
    return {
        **info,
        "stages": {**info["stages"], **stages},
        "layers": sorted({commit.layer for commit in commits}, key=log.layers.index),
        "features": features_of({commit.layer: None for commit in commits}),
        "splits": splits,
        "total_scenes": len(tables["scenes"]),
        "total_frames": len(tables["frames"]),
        "total_failed": sum(len(commit.failed) for commit in commits),
        "tables": dict(hashes),
        "fingerprint": fingerprint_of(log),
    }


def fingerprint_of(log: CommitLog) -> str:
    """sha256 over the content of all fresh commits: equal for equal data, whoever wrote it."""
    digest = sha256()
    for shard in log.shards:
        for layer, commit in log.fresh(shard).items():
            digest.update(f"{layer} {shard} {list(commit.scenes)}\n".encode())
            for name, value in sorted(commit.files.items()):
                digest.update(f"{name} {value}\n".encode())
    return digest.hexdigest()


def _add_shard(parts: Parts, shard: _Shard) -> None:
    """Append the rows of one shard to every table."""
    base = "sim" if "sim" in shard.commits else RECORDED
    scenes = shard.table(base, "scenes")
    frames = shard.table(base, "frames")
    poses = shard.table(base, "tool_poses")
    if scenes is None or frames is None or poses is None:
        return
    timestamps = _timestamps(frames, shard.num_frames)

    def add(name: str, table: pa.Table, **columns: Any) -> None:
        for column, value in columns.items():
            table = table.append_column(column, pa.array(value))
        if name != "scenes":
            table = _with_index(table, timestamps, shard.num_frames)
        schema = shard.schemas[name].remove_metadata()
        for column in sorted(SINCE_1_1 & {*schema.names} - {*table.column_names}):
            table = table.append_column(column, pa.nulls(len(table), schema.field(column).type))
        parts[name].append(table.select(schema.names).cast(schema))

    here = [shard.id] * len(frames)
    add("scenes", _with_failures(scenes, shard.commits), shard=here[: len(scenes)])
    topology = _topology_columns(frames, shard.table("topology", "frames"), shard)
    add("frames", topology, shard=here, row=np.arange(len(frames)))
    add("tool_poses", poses)
    for name in ("topology_events", "graph_nodes", "graph_edges"):
        table = shard.table("topology", name)
        if table is not None:
            add(name, table)
    for layer in shard.commits:
        views = shard.table(layer, "views") if layer.startswith("depth.") else None
        if views is not None:
            add("views", views, layer=[layer] * len(views), shard=[shard.id] * len(views))


def _timestamps(
    frames: pa.Table, num_frames: int
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    # A recording may have fewer key frames than the dataset's scenes.
    keys, times = _keys(frames, num_frames), frames["timestamp"].to_numpy()
    return lambda scene, frame: times[np.searchsorted(keys, scene * num_frames + frame)]


def _with_index(table: pa.Table, timestamps: Times, num_frames: int) -> pa.Table:
    """Add `index` (scene_index * num_frames + frame_index) and `timestamp` [s]."""
    scene, frame = table["scene_index"].to_numpy(), table["frame_index"].to_numpy()
    if "timestamp" not in table.column_names:
        table = table.append_column("timestamp", pa.array(timestamps(scene, frame), pa.float64()))
    return table.append_column("index", pa.array(scene * num_frames + frame))


def _with_failures(scenes: pa.Table, commits: Mapping[str, CommitRecord]) -> pa.Table:
    """Column `failed`: null, or `layer: reason` of every layer that this scene failed in."""
    reasons = [
        "; ".join(f"{k}: {c.failed[i]}" for k, c in commits.items() if i in c.failed) or None
        for i in scenes["scene_index"].to_pylist()
    ]
    return scenes.append_column("failed", pa.array(reasons, pa.string()))


def _topology_columns(frames: pa.Table, topology: pa.Table | None, shard: _Shard) -> pa.Table:
    """Frames of `sim` with the columns of `topology`; null where a scene has none."""
    wanted_columns = [
        column
        for column in (*TOPOLOGY_COLUMNS, *CONTACT_COLUMNS["topology"])
        if column[0] in shard.schemas["frames"].names
    ]
    if topology is None:
        columns: dict[str, Any] = {k: pa.nulls(len(frames), t) for k, t in wanted_columns}
    else:
        keys, wanted = _keys(topology, shard.num_frames), _keys(frames, shard.num_frames)
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        indices = pa.array(place, mask=keys[place] != wanted)
        columns = {name: topology[name].take(indices) for name, _ in wanted_columns}
    for name, column in columns.items():
        frames = frames.append_column(name, column)
    return frames


def _keys(table: pa.Table, num_frames: int) -> np.ndarray:
    return table["scene_index"].to_numpy() * num_frames + table["frame_index"].to_numpy()


def _joined(name: str, tables: list[pa.Table], schema: pa.Schema) -> pa.Table:
    table = pa.concat_tables(tables) if tables else schema.empty_table()
    # Shards hold rising scene_index and rows are sorted within each, so that only layers mix.
    order = ["scene_index"] if name == "scenes" else ["scene_index", "frame_index"]
    keys = [table[column].to_numpy() for column in reversed(order)]
    return table.take(np.lexsort(keys)).combine_chunks().cast(schema)
