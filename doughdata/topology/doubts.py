"""Events with their margins, and the key frames in which the check is unsure, with the reason."""

from collections.abc import Sequence
from dataclasses import replace

from doughdata.topology.decisions import UNSURE, Decision
from doughdata.topology.genus import Shape
from doughdata.topology.history import FrameState
from doughdata.topology.tracking import find_events, groups
from doughschemas import FrameTopology, TopologyEvent

__all__ = ["timed_events", "with_doubts"]

LATE = 4  # key frames by which the genus may follow the pull test that changed it


def timed_events(
    frames: Sequence[FrameTopology],
    shapes: Sequence[Sequence[Shape]],
    states: Sequence[FrameState],
) -> list[TopologyEvent]:
    """What happened in each key frame; a margin is that of the nearest pull test before it."""
    events = []
    for frame in range(1, len(frames)):
        margins: dict[str, float] = {}
        for state in states[max(0, frame - LATE) : frame + 1]:
            margins |= _least_margins([d for d in state.decisions if d.passed])
        # A finger that goes right through a tube leaves no neck to pull at, but an open loop.
        cut = ["split" in margins or shape.parted for shape in shapes[frame]]
        events += find_events(frame, frames[frame - 1], frames[frame], cut=cut, margins=margins)
    return events


def _least_margins(decisions: Sequence[Decision]) -> dict[str, float]:
    """The smallest margin of each kind."""
    kinds = {decision.kind for decision in decisions}
    return {kind: min(d.margin for d in decisions if d.kind == kind) for kind in kinds}


def with_doubts(
    frames: Sequence[FrameTopology],
    shapes: Sequence[Sequence[Shape]],
    states: Sequence[FrameState],
    events: Sequence[TopologyEvent],
) -> tuple[FrameTopology, ...]:
    """The same key frames, each with the reasons why the check is unsure of it."""
    reasons: list[list[str]] = [
        [*_unread(own), *_near_threshold(state.decisions)]
        for own, state in zip(shapes, states, strict=True)
    ]
    for event in events:
        if event.margin < UNSURE:
            for frame in (event.frame - 1, event.frame):
                reasons[frame].append(f"a {event.kind} with a margin of {event.margin:.2f}")
    for frame in _unexplained(frames, states):
        reasons[frame].append("a handle that no merge explains")
    return tuple(
        replace(frame, ambiguous_reason="; ".join(dict.fromkeys(own)))
        for frame, own in zip(frames, reasons, strict=True)
    )


def _unread(shapes: Sequence[Shape]) -> list[str]:
    if all(shape.sure for shape in shapes):
        return []
    return ["the readings or the graph exclude the genus"]


def _near_threshold(decisions: Sequence[Decision]) -> list[str]:
    near = [d for d in decisions if d.margin < UNSURE]
    if not near:
        return []
    worst = min(near, key=lambda d: d.margin)
    return [f"a {worst.kind} test left {worst.paths:.1f} paths, near the threshold"]


def _unexplained(frames: Sequence[FrameTopology], states: Sequence[FrameState]) -> list[int]:
    """Key frames with handles that came without a merge within one piece, until they go again.

    Such a handle is a misread crease or pore, or a merge that the pull tests missed. One that they
    find within the next few key frames explains it from then on.
    """
    found: list[int] = []
    owed: list[int] = []  # the key frame in which each unexplained handle came
    for frame in range(1, len(frames)):
        explained = sum(state.loops for state in states[max(0, frame - LATE) : frame + 1])
        if states[frame].loops:
            owed = [came for came in owed if frame - came > LATE]
        for old, new in groups(frames[frame - 1], frames[frame]):
            gain = sum(frames[frame].genus[k] for k in new)
            gain -= sum(frames[frame - 1].genus[k] for k in old)
            if gain > 0 and explained == 0:
                owed += [frame] * gain
            elif gain < 0:
                owed = owed[:gain]
        if owed:
            found.append(frame)
    return found
