"""Depth and colour images of the same instant; which of them become key frames."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np
from jaxtyping import Int64

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.pictures import PictureError, picture_of
from doughdata.recordings.protocol import Loss
from doughdata.recordings.source import Source
from doughdata.recordings.topics import ChosenTopics

__all__ = ["Pair", "Pairing", "pair_images", "uniform_choice"]

ALONE = 50_000_000  # [ns], tolerance where one image gives no period


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two images, by their numbers within their topics."""

    stamp: int  # [ns], of depth
    depth: int
    color: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """What was found, before every-n-th or a number of frames is chosen."""

    pairs: tuple[Pair, ...]  # by time
    losses: tuple[Loss, ...]
    warnings: tuple[str, ...]
    num_depth: int  # readable images
    num_color: int
    largest_offset: float  # [s], between the two images of a pair
    frame: str  # coordinate frame of the depth images; "" = not said


@dataclass(slots=True)
class _Stream:
    """Times of the readable images of a topic."""

    numbers: list[int]
    stamps: list[int]  # [ns]; 0 = not set
    log_times: list[int]
    sums: list[int]  # CRCs of their data
    frame: str
    bad: dict[str, int]  # reason -> images


def pair_images(source: Source, topics: ChosenTopics) -> Pairing:
    """Pair by the sensors' time stamps: nearest neighbour, at most half a period apart.

    Raises:
        RecordingError: depth and colour were taken in different frames, or nothing pairs.
    """
    streams = _streams(source, topics)
    depth, color = streams[topics.depth], streams.get(topics.color or "")
    stamped = all(all(stream.stamps) for stream in streams.values())
    warnings = [] if stamped else ["images without time stamps: paired by the time of logging"]
    losses = [
        Loss(where=name, count=count, unit="image", reason=reason)
        for name, stream in streams.items()
        for reason, count in stream.bad.items()
    ]
    times, numbers, repeated, twice = _by_time(depth, stamped)
    if len(times) == 0:
        raise RecordingError(f"no image of {topics.depth} can be read{_reasons(depth)}")
    if repeated:
        reason = "same time stamp as another image"
        losses.append(Loss(where=topics.depth, count=repeated, unit="image", reason=reason))
    if twice:
        warnings.append(
            f"{topics.depth}: {twice} images are copies of others of the same time and were left "
            "out"
        )
    chosen, offset = np.full(len(times), -1), 0.0
    if color is not None:
        _check_frames(topics, depth, color)
        chosen, offset = _nearest(times, color, stamped)
        warnings += _alone(topics, int(np.sum(chosen < 0)), len(times))
    return Pairing(
        pairs=tuple(
            Pair(stamp=int(t), depth=int(d), color=int(c) if c >= 0 else None)
            for t, d, c in zip(times, numbers, chosen, strict=True)
            if c >= 0 or color is None
        ),
        losses=tuple(losses),
        warnings=tuple(warnings),
        num_depth=len(depth.numbers),
        num_color=0 if color is None else len(color.numbers),
        largest_offset=offset,
        frame=depth.frame,
    )


def uniform_choice(pairs: tuple[Pair, ...], most: int) -> tuple[Pair, ...]:
    """At most `most` pairs, nearest to instants that divide the time evenly, both ends included."""
    if len(pairs) <= most:
        return pairs
    stamps = np.array([pair.stamp for pair in pairs])
    wanted = np.linspace(stamps[0], stamps[-1], most)
    right = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    nearest = right - (wanted - stamps[right - 1] <= stamps[right] - wanted)
    return tuple(pairs[k] for k in sorted(set(nearest.tolist())))


def _streams(source: Source, topics: ChosenTopics) -> dict[str, _Stream]:
    names = [topics.depth] + ([topics.color] if topics.color else [])
    streams = {name: _Stream([], [], [], [], "", {}) for name in names}
    for message in source.messages(names):
        stream = streams[message.topic]
        try:
            picture = picture_of(message, source.topics[message.topic].kind)
        except PictureError as error:
            stream.bad[str(error)] = stream.bad.get(str(error), 0) + 1
            continue
        stream.numbers.append(message.number)
        stream.stamps.append(picture.stamp)
        stream.log_times.append(message.log_time)
        stream.sums.append(crc32(picture.data))
        stream.frame = stream.frame or picture.frame
    return streams


def _by_time(
    depth: _Stream, stamped: bool
) -> tuple[Int64[np.ndarray, " images"], Int64[np.ndarray, " images"], int, int]:
    """Rising times and the numbers of their images; the first image of a time is taken.

    Also how many others there are of a time already taken, and how many with the same bytes.
    """
    every = _times(depth, stamped)
    times, first, place = np.unique(every, return_index=True, return_inverse=True)
    sums = np.array(depth.sums, np.int64)
    copies = int(np.sum(sums == sums[first][place.reshape(-1)])) - len(first)
    numbers = np.array(depth.numbers, np.int64)[first]
    return times, numbers, len(every) - len(times) - copies, copies


def _alone(topics: ChosenTopics, alone: int, total: int) -> list[str]:
    """A line about depth images without a colour image.

    Raises:
        RecordingError: none has one.
    """
    if alone == total:
        raise RecordingError(
            f"no image of {topics.depth} has one of {topics.color} within half a frame; "
            "--color-topic none converts depth alone"
        )
    if not alone:
        return []
    return [
        f"{alone} of {total} depth images have no colour image within half a frame "
        "and were left out"
    ]


def _times(stream: _Stream, stamped: bool) -> Int64[np.ndarray, " images"]:
    return np.array(stream.stamps if stamped else stream.log_times, np.int64)


def _nearest(
    times: Int64[np.ndarray, " images"], color: _Stream, stamped: bool
) -> tuple[Int64[np.ndarray, " images"], float]:
    """Number of the colour image nearest to each time, -1 where it is too far; largest offset."""
    stamps = _times(color, stamped)
    if len(stamps) == 0:
        return np.full(len(times), -1), 0.0
    order = np.argsort(stamps, kind="stable")
    stamps, numbers = stamps[order], np.array(color.numbers)[order]
    # The shorter period of the two: where images were lost, the own one is too long.
    periods = [float(np.median(np.diff(t))) for t in (times, stamps) if len(t) > 1]
    tolerance = min(periods) / 2 if periods and min(periods) > 0 else ALONE
    right = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(times - stamps[left] <= np.abs(stamps[right] - times), left, right)
    offset = np.abs(stamps[nearest] - times)
    near = offset <= tolerance
    return np.where(near, numbers[nearest], -1), float(offset[near].max(initial=0)) / 1e9


def _check_frames(topics: ChosenTopics, depth: _Stream, color: _Stream) -> None:
    if depth.frame and color.frame and depth.frame != color.frame:
        raise RecordingError(
            f"{topics.depth} was taken in frame {depth.frame!r}, {topics.color} in "
            f"{color.frame!r}: record depth aligned to colour (aligned_depth_to_color), "
            "or leave colour out with --color-topic none"
        )


def _reasons(stream: _Stream) -> str:
    return f": {'; '.join(list(stream.bad)[:3])}" if stream.bad else ""
