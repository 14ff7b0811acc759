"""What the numbers of layer `sim` must satisfy: positions, times, units, openings, poses."""

import json
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from jaxtyping import Float32

from doughdata.dataset.layers.columns import vectors_array
from doughdata.dataset.layers.sim import decode_tool_poses
from doughdata.dataset.report import Problem
from doughdata.dataset.shards import LayerShard
from doughschemas import ToolPoses

__all__ = ["pose_problems", "sim_problems"]

UNIT_TOLERANCE = 1e-6  # of a quaternion's length
REACH = 1.0  # [m] from the origin; dough lies within 0.15 m, so millimetres cannot pass for metres
BELOW_TABLE = 0.01  # [m]
SPACING = (1e-5, 0.02)  # [m] of particles
OPENING_TOLERANCE = 1e-6  # [m], between the opening and the distance of the fingers
Problems = Iterator[Problem]
Frames = tuple[tuple[int, int], ...]  # (scene_index, frame_index)


def sim_problems(shard: LayerShard) -> Problems:
    """Problems of one shard. Raises as the shard's arrays and tables do when they are damaged."""
    file = str(shard.commit.path)
    for index in shard.commit.scenes:
        yield from _positions(shard, index)
        times = shard.table("frames").scene(index)["timestamp"].to_numpy()
        if not np.isfinite(times).all() or np.any(np.diff(times) <= 0):
            yield Problem(file=file, message=f"scene {index}: timestamps must rise")
        spacing = shard.table("scenes").scene(index)["particle_spacing"][0].as_py()
        if not SPACING[0] <= spacing <= SPACING[1]:
            message = f"scene {index}: particles of {spacing:g} m: not in metres?"
            yield Problem(file=f"{file}/scenes.parquet", message=message)
        yield from _openings(shard, index)
    yield from pose_problems(shard.table("tool_poses").table, f"{file}/tool_poses.parquet")


def pose_problems(table: pa.Table, file: str) -> Problems:
    """Positions finite and near, quaternions unit; of tools and of cameras."""
    position = vectors_array(table["position"], 3, np.float64)
    quaternion = vectors_array(table["quaternion"], 4, np.float64)
    length = np.linalg.norm(quaternion, axis=1)
    bad = ~np.isfinite(position).all(axis=1) | ~(np.abs(length - 1) < UNIT_TOLERANCE)
    if bad.any():
        message = "poses must be finite, with unit quaternions"
        yield Problem(file=file, message=message, frames=_frames(table, bad))


def _positions(shard: LayerShard, index: int) -> Problems:
    """As many particles in every frame, each at a place where dough can be."""
    start = shard.rows.start(index)
    counts = shard.array("num_particles").rows(start, start + shard.rows.num_frames)
    wrong: dict[str, list[tuple[int, int]]] = {}
    for frame, count in enumerate(counts):
        positions = shard.array("positions").row(start + frame)[:count]
        if count != counts[0] or not np.isfinite(positions).all():
            message = "particle positions must be finite and as many in every frame"
            wrong.setdefault(message, []).append((index, frame))
        elif not _near(positions):
            message = f"particles lie under the table or more than {REACH:g} m away: not in metres?"
            wrong.setdefault(message, []).append((index, frame))
    for message, frames in wrong.items():
        yield Problem(file=str(shard.commit.path), message=message, frames=tuple(frames))


def _near(positions: Float32[np.ndarray, "particles 3"]) -> bool:
    if len(positions) == 0:
        return True
    return bool(np.abs(positions).max() <= REACH and positions[:, 2].min() >= -BELOW_TABLE)


def _openings(shard: LayerShard, index: int) -> Problems:
    """Every key frame belongs to an action, and the fingers are as far apart as it says."""
    parameters = json.loads(shard.table("scenes").scene(index)["parameters"][0].as_py())
    actions, poses = parameters["actions"], decode_tool_poses(shard, index)
    file = f"{shard.commit.path}/tool_poses.parquet"
    strange = (poses.action < 0) | (poses.action >= len(actions))
    if strange.any():
        message = f"action must be 0..{len(actions) - 1}"
        yield Problem(file=file, message=message, frames=_scene_frames(index, strange))
        return
    outside = ~((poses.opening >= 0.0) & (poses.opening <= REACH))
    if outside.any():
        message = f"the opening must lie between 0 and {REACH:g} m"
        yield Problem(file=file, message=message, frames=_scene_frames(index, outside))
    apart = ~(np.abs(_gap(poses) - poses.opening) < OPENING_TOLERANCE)
    if apart.any():
        message = "the fingers are not as far apart as the opening says"
        yield Problem(file=file, message=message, frames=_scene_frames(index, apart))


def _gap(poses: ToolPoses) -> np.ndarray:
    """Distance [m] between the contact faces: the origins of the finger frames lie in them."""
    if poses.position.shape[1] != 2:
        return poses.opening
    return np.linalg.norm(poses.position[:, 0] - poses.position[:, 1], axis=1)


def _scene_frames(index: int, bad: np.ndarray) -> Frames:
    return tuple((index, int(frame)) for frame in np.flatnonzero(bad))


def _frames(table: pa.Table, bad: np.ndarray) -> Frames:
    keys = [table[name].to_numpy()[bad].tolist() for name in ("scene_index", "frame_index")]
    return tuple(sorted(set(zip(*keys, strict=True))))
