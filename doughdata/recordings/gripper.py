"""How far the gripper was open at each key frame, from a topic that the user names."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pictures import stamp_of
from doughdata.recordings.source import Message, Source

__all__ = ["gripper_opening"]

NEAR = 0.05  # [s]; before the first and after the last sample the value is held so long
CLOSED, WIDEST = 0.005, 1.0  # [m]; closed fingers may read a little below 0
MILLIMETRES = ("wsg",)  # packages whose messages give the width in mm


def gripper_opening(
    source: Source, options: TopicOptions, stamps: Sequence[int]
) -> Float64[np.ndarray, " frames"]:
    """Opening [m] at each stamp [ns], linear between samples; NaN where it is unknown.

    `options.gripper_topic` is TOPIC or TOPIC:FIELD: of JointState the name of a joint (never its
    place), of other types a field, by default `width`.

    Raises:
        RecordingError: no such topic, joint or field, or values that are no numbers.
    """
    if options.gripper_topic is None:
        return np.full(len(stamps), np.nan)
    name, _, field = options.gripper_topic.partition(":")
    topic = source.topics.get(name)
    if topic is None or not topic.count:
        raise RecordingError(f"--gripper-topic: no topic {name} with messages")
    times, values = [], []
    for message in source.messages([name]):
        value = None if message.error else _value(message, topic.kind, name, field)
        if value is not None:
            times.append(stamp_of(message.value) or message.log_time)
            values.append(value)
    if not values:
        raise RecordingError(f"--gripper-topic: no message of {name} gives {field or 'a width'}")
    scale = options.gripper_scale
    if scale is None:
        scale = 1e-3 if topic.schema.lower().startswith(MILLIMETRES) else 1.0
    _check_metres(options.gripper_topic, np.array(values, float) * scale)
    order = np.argsort(times, kind="stable")
    seconds = (np.array(times, np.int64)[order] - stamps[0]) / 1e9
    wanted = (np.array(stamps, np.int64) - stamps[0]) / 1e9
    opening = np.interp(wanted, seconds, np.array(values, float)[order] * scale)
    outside = (wanted < seconds[0] - NEAR) | (wanted > seconds[-1] + NEAR)
    return np.where(outside, np.nan, opening)


def _check_metres(topic: str, opening: Float64[np.ndarray, " samples"]) -> None:
    """Refuse what is no opening of a gripper in metres."""
    low, high = float(opening.min()), float(opening.max())
    if low < -CLOSED or high > WIDEST:
        raise RecordingError(
            f"--gripper-topic {topic}: it opens from {low:g} to {high:g} m, not within 0 to "
            f"{WIDEST:g} m; --gripper-scale says how many metres a unit is"
        )


def _joints(value: Any) -> dict[str, float]:
    """Joint -> position, of ROS's JointState and Foxglove's JointStates."""
    if hasattr(value, "joints"):
        return {str(joint.name): float(joint.position) for joint in value.joints}
    return {str(n): float(p) for n, p in zip(value.name, value.position, strict=False)}


def _value(message: Message, kind: str, topic: str, field: str) -> float | None:
    """The number in a message, or None if this one does not hold it."""
    value: Any = message.value
    try:
        if kind in ("JointState", "JointStates"):
            joints = _joints(value)
            names = list(joints)
            if not field and len(names) != 1:
                raise RecordingError(
                    f"--gripper-topic {topic}: say which joint with {topic}:JOINT "
                    f"({', '.join(names[:12])})"
                )
            if field and field not in names:
                return None  # drivers publish parts of the robot in turn
            value = joints[field or names[0]]
        else:
            for part in (field or "width").split("."):
                value = getattr(value, part)
        return float(value) if np.isfinite(float(value)) else None
    except (AttributeError, TypeError, ValueError, IndexError) as error:
        raise RecordingError(
            f"--gripper-topic {topic}: its messages have no number {field or 'width'!r}"
        ) from error
