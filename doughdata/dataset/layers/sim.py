"""Layer `sim`: particles, tool poses, and the scenes themselves."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from doughdata.dataset.arrays import ArraySpec, padded_length
from doughdata.dataset.contacts import CONTACT_COLUMNS, contact_arrays
from doughdata.dataset.layers.columns import frame_columns, vectors, vectors_array
from doughdata.dataset.shards import Encoded, LayerShard, ShardRows
from doughdata.scenes import scene_to_json
from doughschemas import BadInputError, Particles, Scene, ToolPoses

__all__ = ["decode_particles", "encode_sim"]


def encode_sim(
    particles: Mapping[int, Particles],
    scenes: Mapping[int, Scene],
    rows: ShardRows,
    *,
    contacts: Mapping[int, Mapping[str, Sequence[Any]]],
) -> Encoded:
    """Arrays `positions`, `object_ids`, `num_particles`; tables scenes, frames, tool_poses.

    `contacts` are the scenes' columns from `particle_contacts`.

    Raises:
        BadInputError: a scene has another number of key frames than the dataset.
    """
    width = padded_length(max(p.positions.shape[1] for p in particles.values()))
    positions = np.full((rows.count, width, 3), np.nan, np.float32)
    object_ids = np.full((rows.count, width), 255, np.uint8)
    counts = np.zeros(rows.count, np.int32)
    for index, record in particles.items():
        frames, count, _ = record.positions.shape
        if frames != rows.num_frames:
            raise BadInputError(
                f"scene {index}: {frames} key frames, but the dataset has {rows.num_frames}"
            )
        place = slice(rows.start(index), rows.start(index) + frames)
        positions[place, :count] = record.positions
        object_ids[place, :count] = record.object_ids
        counts[place] = count
    arrays = {
        "positions": ArraySpec(data=positions, axes=("row", "particle", "xyz"), fill=np.nan),
        "object_ids": ArraySpec(data=object_ids, axes=("row", "particle"), fill=255),
        "num_particles": ArraySpec(data=counts, axes=("row",), fill=0, by_row=False),
    }
    order = {index: particles[index] for index in rows.scenes}
    tables = {
        "scenes": _scenes_table(order, scenes, rows),
        "frames": _frames_table(order, contacts),
        "tool_poses": _tool_table(order),
    }
    return Encoded(arrays=arrays, tables=tables)


def decode_particles(shard: LayerShard, scene_index: int) -> Particles:
    """All key frames of one scene, exactly as they were written."""
    start = shard.rows.start(scene_index)
    stop = start + shard.rows.num_frames
    count = int(shard.array("num_particles").row(start))
    frames = shard.table("frames").scene(scene_index)
    scene = shard.table("scenes").scene(scene_index)
    return Particles(
        positions=np.ascontiguousarray(shard.array("positions").rows(start, stop)[:, :count]),
        object_ids=shard.array("object_ids").row(start)[:count].copy(),
        timestamps=frames["timestamp"].to_numpy().copy(),
        tool_poses=decode_tool_poses(shard, scene_index),
        spacing=scene["particle_spacing"][0].as_py(),
    )


def decode_tool_poses(shard: LayerShard, scene_index: int) -> ToolPoses:
    """Finger poses of one scene at all key frames."""
    frames = shard.table("frames").scene(scene_index)
    poses = shard.table("tool_poses").scene(scene_index)
    shape = (shard.rows.num_frames, len(poses) // shard.rows.num_frames)
    return ToolPoses(
        position=vectors_array(poses["position"], 3, np.float64).reshape(*shape, 3),
        quaternion=vectors_array(poses["quaternion"], 4, np.float64).reshape(*shape, 4),
        opening=frames["opening"].to_numpy().copy(),
        action=frames["action"].to_numpy().astype(np.int32),
    )


def _scenes_table(
    particles: Mapping[int, Particles], scenes: Mapping[int, Scene], rows: ShardRows
) -> pa.Table:
    entries = []
    for index, record in particles.items():
        scene = scenes[index]
        entries.append(
            {
                "scene_index": index,
                "scene_id": scene.scene_id,
                "family": scene.family,
                "split": scene.split,
                "region": scene.region,
                "seed": scene.seed,
                "num_frames": rows.num_frames,
                "duration": scene.duration,
                "num_particles": record.positions.shape[1],
                "particle_spacing": float(record.spacing),
                "num_bodies": len(scene.bodies),
                "num_actions": len(scene.actions),
                "tools": [tool.name for tool in scene.tools],
                "parameters": json.dumps(scene_to_json(scene)),
            }
        )
    schema = pa.schema(
        [
            ("scene_index", pa.int64()),
            ("scene_id", pa.string()),
            ("family", pa.string()),
            ("split", pa.string()),
            ("region", pa.string()),
            ("seed", pa.int64()),
            ("num_frames", pa.int32()),
            ("duration", pa.float64()),
            ("num_particles", pa.int32()),
            ("particle_spacing", pa.float64()),
            ("num_bodies", pa.int32()),
            ("num_actions", pa.int32()),
            ("tools", pa.list_(pa.string())),
            ("parameters", pa.string()),
        ]
    )
    return pa.Table.from_pylist(entries, schema=schema)


def _frames_table(
    particles: Mapping[int, Particles], contacts: Mapping[int, Mapping[str, Sequence[Any]]]
) -> pa.Table:
    lengths = {index: len(record.timestamps) for index, record in particles.items()}
    frames = {k: np.arange(n) for k, n in lengths.items()}
    records = particles.values()
    columns = {
        name: [value for index in particles for value in contacts[index][name]]
        for name, _ in CONTACT_COLUMNS["sim"]
    }
    return pa.table(
        {
            **frame_columns(frames),
            "timestamp": np.concatenate([r.timestamps for r in records]).astype(np.float64),
            "num_particles": np.concatenate(
                [np.full(len(r.timestamps), r.positions.shape[1], np.int32) for r in records]
            ),
            "opening": np.concatenate([r.tool_poses.opening for r in records]).astype(np.float64),
            "action": np.concatenate([r.tool_poses.action for r in records]).astype(np.int32),
            **contact_arrays("sim", columns),
        }
    )


def _tool_table(particles: Mapping[int, Particles]) -> pa.Table:
    frames, body, position, quaternion, opening, action = {}, [], [], [], [], []
    for index, record in particles.items():
        poses = record.tool_poses
        count, fingers, _ = poses.position.shape
        frames[index] = np.repeat(np.arange(count), fingers)
        body.append(np.tile(np.arange(fingers, dtype=np.int32), count))
        position.append(poses.position.reshape(-1, 3))
        quaternion.append(poses.quaternion.reshape(-1, 4))
        opening.append(np.repeat(poses.opening, fingers))
        action.append(np.repeat(poses.action, fingers))
    return pa.table(
        {
            **frame_columns(frames),
            "body": np.concatenate(body),
            "position": vectors(np.concatenate(position), np.float64),
            "quaternion": vectors(np.concatenate(quaternion), np.float64),
            "opening": np.concatenate(opening).astype(np.float64),
            "action": np.concatenate(action).astype(np.int32),
        }
    )
