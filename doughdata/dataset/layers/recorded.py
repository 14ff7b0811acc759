"""Layer `depth.recorded`: images of a real camera. It has no layer before it, so that it carries
the tables of scenes, key frames and tool poses itself.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64, UInt8

from doughdata.dataset.layers.columns import frame_columns, vectors
from doughdata.dataset.layers.depth import INTRINSICS
from doughdata.dataset.shards import Encoded, LayerShard, ShardRows
from doughdata.dataset.spool import SpooledArray
from doughschemas import BadInputError, Camera

__all__ = ["RECORDED_FAMILY", "RECORDED_SPLIT", "RecordedScene", "decode_color", "encode_recorded"]

RECORDED_FAMILY, RECORDED_SPLIT = "recording", "real"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedScene:
    """One recording, ready to be written. Frame k is row k of all arrays; one camera, one view."""

    scene_id: str
    camera: Camera  # of all frames
    timestamps: Float64[np.ndarray, " frames"]  # [s] since the first frame
    depth: SpooledArray  # u16 (frame, y, x), with the attribute depth_unit
    segments: SpooledArray  # u8 (frame, y, x)
    color: SpooledArray | None  # u8 (frame, y, x, 3), RGB
    num_bodies: int  # pieces in the first frame
    opening: Float64[np.ndarray, " frames"]  # [m] of the gripper, NaN = unknown
    tool_frames: Sequence[int] = ()  # key frames in which the gripper's pose is known
    tool_position: Float64[np.ndarray, "poses 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    tool_quaternion: Float64[np.ndarray, "poses 4"] = field(
        default_factory=lambda: np.zeros((0, 4))
    )
    parameters: Mapping[str, Any] = field(default_factory=dict)  # where it comes from; JSON


def encode_recorded(records: Mapping[int, RecordedScene], rows: ShardRows) -> Encoded:
    """Arrays `depth`, `segments` and, if there is colour, `color`; tables of one scene.

    Raises:
        BadInputError: not exactly one scene, or more frames than the dataset's scenes have.
    """
    if len(records) != 1:
        raise BadInputError(f"a shard holds one recording, got {len(records)}")
    ((index, record),) = records.items()
    count = len(record.timestamps)
    if not 0 < count <= rows.num_frames:
        raise BadInputError(
            f"scene {index}: {count} key frames, but the dataset's scenes have {rows.num_frames}"
        )
    arrays: dict[str, Any] = {"depth": record.depth, "segments": record.segments}
    if record.color is not None:
        arrays["color"] = record.color
    frames = frame_columns({index: np.arange(count)})
    tables = {
        "scenes": _scenes(index, record),
        "frames": pa.table(
            {
                **frames,
                "timestamp": record.timestamps,
                "num_particles": np.zeros(count, np.int32),
                "opening": pa.array(record.opening, from_pandas=True),  # NaN becomes null
                "action": pa.nulls(count, pa.int32()),
            }
        ),
        "tool_poses": _tool_poses(index, record),
        "views": _views(frames, record.camera),
    }
    return Encoded(arrays=arrays, tables=tables)


def decode_color(
    shard: LayerShard, scene_index: int, frame_index: int | None = None
) -> UInt8[np.ndarray, "views rows columns 3"] | None:
    """RGB images of a scene or of one key frame; None if the recording had no colour."""
    if "color" not in shard.array_names:
        return None
    index = shard.table("views")
    table = (
        index.scene(scene_index) if frame_index is None else index.frame(scene_index, frame_index)
    )
    start = table["row"][0].as_py() if len(table) else 0
    return shard.array("color").rows(start, start + len(table))


def _scenes(index: int, record: RecordedScene) -> pa.Table:
    return pa.table(
        {
            "scene_index": pa.array([index], pa.int64()),
            "scene_id": [record.scene_id],
            "family": [RECORDED_FAMILY],
            "split": [RECORDED_SPLIT],
            "region": ["custom"],
            "seed": pa.array([0], pa.int64()),
            "num_frames": pa.array([len(record.timestamps)], pa.int32()),
            "duration": [float(record.timestamps[-1])],
            "num_particles": pa.array([0], pa.int32()),
            "particle_spacing": pa.nulls(1, pa.float64()),
            "num_bodies": pa.array([record.num_bodies], pa.int32()),
            "num_actions": pa.array([0], pa.int32()),
            "tools": pa.array([[]], pa.list_(pa.string())),
            "parameters": [json.dumps(dict(record.parameters))],
        }
    )


def _tool_poses(index: int, record: RecordedScene) -> pa.Table:
    known = np.array(record.tool_frames, np.int64)
    return pa.table(
        {
            **frame_columns({index: known}),
            "body": np.zeros(len(known), np.int32),
            "position": vectors(record.tool_position, np.float64),
            "quaternion": vectors(record.tool_quaternion, np.float64),
            "opening": pa.array(record.opening[known], from_pandas=True),
            "action": pa.nulls(len(known), pa.int32()),
        }
    )


def _views(frames: Mapping[str, np.ndarray], camera: Camera) -> pa.Table:
    count = len(frames["frame_index"])
    return pa.table(
        {
            **frames,
            "view_index": np.zeros(count, np.int32),
            "row": np.arange(count, dtype=np.int64),
            "position": vectors(np.tile(camera.position, (count, 1)), np.float64),
            "quaternion": vectors(np.tile(camera.quaternion, (count, 1)), np.float64),
            **{
                name: np.full(count, getattr(camera.intrinsics, name), dtype)
                for name, dtype in INTRINSICS.items()
            },
        }
    )
