"""Layer `topology`: labels as an array; graph, events, contacts and bonds as tables."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from doughdata.dataset.arrays import ArraySpec, padded_length
from doughdata.dataset.contacts import contact_arrays, piece_contacts
from doughdata.dataset.layers.columns import frame_columns, int_lists, vectors
from doughdata.dataset.shards import Encoded, LayerShard, ShardRows, TableIndex
from doughschemas import STRAY, BadInputError, FrameTopology, SceneGraph, Topology, TopologyEvent

__all__ = ["decode_frame_topology", "decode_genus", "decode_topology", "encode_topology"]

PerFrame = Callable[[Topology], list[Any]]  # one value per key frame


def encode_topology(topologies: Mapping[int, Topology], rows: ShardRows) -> Encoded:
    """Array `labels`; tables frames, topology_events, graph_nodes, graph_edges, contacts, bonds.

    Raises:
        BadInputError: a scene has another number of key frames than the dataset.
    """
    for index, topology in topologies.items():
        if len(topology.frames) != rows.num_frames:
            raise BadInputError(
                f"scene {index}: {len(topology.frames)} key frames, dataset has {rows.num_frames}"
            )
    topologies = {i: topologies[i] for i in rows.scenes if i in topologies}
    width = padded_length(max(len(t.frames[0].labels) for t in topologies.values()))
    labels = np.full((rows.count, width), STRAY, np.uint8)
    for index, topology in topologies.items():
        start = rows.start(index)
        for k, frame in enumerate(topology.frames):
            labels[start + k, : len(frame.labels)] = frame.labels
    tables = {
        "frames": _frames_table(topologies),
        "topology_events": _events_table(topologies),
        "graph_nodes": _nodes_table(topologies),
        "graph_edges": _pairs_table(topologies, lambda t: [f.graph.edges for f in t.frames]),
        "contacts": _pairs_table(topologies, lambda t: [f.contacts for f in t.frames]),
        "bonds": _bonds_table(topologies),
    }
    spec = ArraySpec(data=labels, axes=("row", "particle"), fill=STRAY)
    return Encoded(arrays={"labels": spec}, tables=tables)


def decode_frame_topology(
    shard: LayerShard, scene_index: int, frame_index: int, *, num_particles: int
) -> FrameTopology:
    """Topology of one key frame, exactly as it was written."""
    key = (scene_index, frame_index)
    frames, nodes = shard.table("frames"), shard.table("graph_nodes")
    at, here = frames.frame_rows(*key).start, nodes.frame_rows(*key)
    frames.load(("genus", "ambiguous_reason"), slice(at, at + 1))
    nodes.load(("position", "component", "particles"), here)
    row = shard.rows.start(scene_index) + frame_index
    return FrameTopology(
        labels=shard.array("labels").row(row)[:num_particles].copy(),
        genus=tuple(frames.value("genus", at)),
        graph=SceneGraph(
            positions=nodes.values("position", here).astype(np.float32),
            components=nodes.values("component", here).astype(np.uint8),
            particles=nodes.values("particles", here).astype(np.int32),
            edges=_frame_pairs(shard.table("graph_edges"), key),
        ),
        contacts=_frame_pairs(shard.table("contacts"), key),
        ambiguous_reason=frames.value("ambiguous_reason", at),
    )


def decode_genus(shard: LayerShard, scene_index: int, frame_index: int) -> tuple[int, ...]:
    """Genus of every component in one key frame; nothing else is read."""
    frames = shard.table("frames")
    return tuple(frames.value("genus", frames.frame_rows(scene_index, frame_index).start))


def decode_events(shard: LayerShard, scene_index: int) -> tuple[TopologyEvent, ...]:
    """All events of one scene."""
    return tuple(
        TopologyEvent(
            frame=event["frame_index"],
            kind=event["kind"],
            components_before=tuple(event["components_before"]),
            components_after=tuple(event["components_after"]),
            margin=event["margin"],
        )
        for event in shard.table("topology_events").scene(scene_index).to_pylist()
    )


def decode_topology(shard: LayerShard, scene_index: int, *, num_particles: int) -> Topology:
    """Topology of one scene, exactly as it was written."""
    count = shard.rows.num_frames
    frames = shard.table("frames").scene(scene_index)
    bonds = [shard.table("bonds").frame(scene_index, k) for k in range(count)]
    made = [b["made"].to_numpy(zero_copy_only=False) for b in bonds]
    pairs = [_pairs(b) for b in bonds]
    return Topology(
        frames=tuple(
            decode_frame_topology(shard, scene_index, k, num_particles=num_particles)
            for k in range(count)
        ),
        events=decode_events(shard, scene_index),
        static_num_components=frames["static_num_components"].to_numpy().astype(np.int32),
        static_genus=tuple(tuple(genus) for genus in frames["static_genus"].to_pylist()),
        bonds_made=tuple(p[m] for p, m in zip(pairs, made, strict=True)),
        bonds_broken=tuple(p[~m] for p, m in zip(pairs, made, strict=True)),
    )


def _frames_table(topologies: Mapping[int, Topology]) -> pa.Table:
    frames = [frame for t in topologies.values() for frame in t.frames]
    static = [t.static_num_components for t in topologies.values()]
    return pa.table(
        {
            **frame_columns({i: np.arange(len(t.frames)) for i, t in topologies.items()}),
            "num_components": np.array([f.num_components for f in frames], np.int32),
            "genus": int_lists([f.genus for f in frames]),
            "ambiguous": np.array([f.ambiguous for f in frames], bool),
            "ambiguous_reason": pa.array([f.ambiguous_reason for f in frames], pa.string()),
            "static_num_components": np.concatenate(static).astype(np.int32),
            "static_genus": int_lists([g for t in topologies.values() for g in t.static_genus]),
            **contact_arrays("topology", piece_contacts(frames)),
        }
    )


def _events_table(topologies: Mapping[int, Topology]) -> pa.Table:
    # Sorted by frame (a stable sort), so that look-up by frame works.
    ordered = {i: sorted(t.events, key=lambda e: e.frame) for i, t in topologies.items()}
    events = [event for entries in ordered.values() for event in entries]
    frames = {i: np.array([e.frame for e in v], np.int32) for i, v in ordered.items()}
    return pa.table(
        {
            **frame_columns(frames),
            "kind": pa.array([e.kind for e in events], pa.string()),
            "components_before": int_lists([e.components_before for e in events]),
            "components_after": int_lists([e.components_after for e in events]),
            "margin": np.array([e.margin for e in events], np.float64),
        }
    )


def _nodes_table(topologies: Mapping[int, Topology]) -> pa.Table:
    graphs = {i: [f.graph for f in t.frames] for i, t in topologies.items()}
    flat = [graph for entries in graphs.values() for graph in entries]
    lengths = {i: np.array([len(g.particles) for g in v]) for i, v in graphs.items()}
    return pa.table(
        {
            **frame_columns({i: np.repeat(np.arange(len(n)), n) for i, n in lengths.items()}),
            "node": np.concatenate([np.arange(len(g.particles), dtype=np.int32) for g in flat]),
            "component": np.concatenate([g.components for g in flat]).astype(np.uint8),
            "position": vectors(np.concatenate([g.positions for g in flat]), np.float32),
            "particles": np.concatenate([g.particles for g in flat]).astype(np.int32),
        }
    )


def _pairs_table(topologies: Mapping[int, Topology], values: PerFrame) -> pa.Table:
    pairs = {i: values(t) for i, t in topologies.items()}
    frames = {
        i: np.repeat(np.arange(len(entries)), [len(p) for p in entries])
        for i, entries in pairs.items()
    }
    flat = np.concatenate([p.reshape(-1, 2) for v in pairs.values() for p in v]).astype(np.int32)
    return pa.table({**frame_columns(frames), "a": flat[:, 0], "b": flat[:, 1]})


def _bonds_table(topologies: Mapping[int, Topology]) -> pa.Table:
    def changes(t: Topology) -> list[np.ndarray]:
        return [np.concatenate(both) for both in zip(t.bonds_made, t.bonds_broken, strict=True)]

    made = [
        np.repeat([True, False], [len(new), len(gone)])
        for t in topologies.values()
        for new, gone in zip(t.bonds_made, t.bonds_broken, strict=True)
    ]
    table = _pairs_table(topologies, changes)
    return table.append_column("made", pa.array(np.concatenate(made).astype(bool)))


def _frame_pairs(index: TableIndex, key: tuple[int, int]) -> np.ndarray:
    here = index.frame_rows(*key)
    index.load(("a", "b"), here)
    pairs = np.empty((here.stop - here.start, 2), np.int32)
    pairs[:, 0], pairs[:, 1] = index.values("a", here), index.values("b", here)
    return pairs


def _pairs(table: pa.Table) -> np.ndarray:
    columns = [table[name].to_numpy().astype(np.int32) for name in ("a", "b")]
    return np.stack(columns, axis=1)
