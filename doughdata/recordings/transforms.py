"""Where one coordinate frame is in another, from a recording's tf messages."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from doughdata.geometry import quaternion_to_matrix
from doughdata.recordings.pictures import frame_of, stamp_of
from doughdata.recordings.source import Source

__all__ = ["TRANSFORMS", "TransformTree", "read_transforms"]

TRANSFORMS = ("TFMessage", "FrameTransforms", "FrameTransform")  # kinds of topics
NEAR = 100_000_000  # [ns]; an older or newer moving transform is not used
Pose = Float64[np.ndarray, "4 4"]


@dataclass(slots=True)
class _Edge:
    """Transforms of a frame in its parent, by time; a static one holds for ever."""

    parent: str
    static: bool
    times: list[int] = field(default_factory=list)  # [ns]
    poses: list[Pose] = field(default_factory=list)


class TransformTree:
    """All transforms of a recording."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._edges or any(e.parent == frame for e in self._edges.values())

    def add(self, parent: str, child: str, time: int, pose: Pose, *, static: bool) -> None:
        """Add one transform; samples may come in any order."""
        edge = self._edges.setdefault(child, _Edge(parent, static))
        place = bisect_left(edge.times, time)
        edge.times.insert(place, time)
        edge.poses.insert(place, pose)

    def pose(self, frame: str, within: str, time: int) -> Pose | None:
        """Frame -> `within` at a time [ns], nearest samples; None if they are not connected."""
        up, down = self._to_root(frame, time), self._to_root(within, time)
        if up is None or down is None or up[0] != down[0]:
            return None
        return np.linalg.inv(down[1]) @ up[1]

    def _to_root(self, frame: str, time: int) -> tuple[str, Pose] | None:
        pose = np.eye(4)
        for _ in range(len(self._edges) + 1):  # a loop in damaged data must end
            edge = self._edges.get(frame)
            if edge is None:
                return frame, pose
            place = min(bisect_left(edge.times, time), len(edge.times) - 1)
            if place and abs(edge.times[place - 1] - time) < abs(edge.times[place] - time):
                place -= 1
            if not edge.static and abs(edge.times[place] - time) > NEAR:
                return None
            pose, frame = edge.poses[place] @ pose, edge.parent
        return None


def read_transforms(source: Source) -> TransformTree:
    """All tf messages of a recording; those that are damaged or no rotation are left out."""
    tree = TransformTree()
    topics = [t.name for t in source.topics.values() if t.kind in TRANSFORMS and t.count]
    for message in source.messages(topics):
        static = message.topic.rstrip("/").endswith("static")
        for entry in () if message.error else _entries(message.value):
            try:
                time = stamp_of(entry) or message.log_time
                tree.add(*_frames(entry), time, _pose(entry), static=static)
            except (AttributeError, TypeError, ValueError):
                continue
    return tree


def _entries(value: Any) -> Iterator[Any]:
    yield from value.transforms if hasattr(value, "transforms") else [value]


def _frames(entry: Any) -> tuple[str, str]:
    parent = entry.parent_frame_id if hasattr(entry, "parent_frame_id") else frame_of(entry)
    return str(parent).lstrip("/"), str(entry.child_frame_id).lstrip("/")


def _pose(entry: Any) -> Pose:
    inner = getattr(entry, "transform", entry)
    move, turn = inner.translation, inner.rotation
    pose = np.eye(4)
    pose[:3, :3] = quaternion_to_matrix(np.array([turn.x, turn.y, turn.z, turn.w], float))
    pose[:3, 3] = [move.x, move.y, move.z]
    if not np.isfinite(pose).all():
        raise ValueError("not finite")
    return pose
