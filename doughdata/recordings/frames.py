"""Decoded pairs of images, one after the other in the order of time."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.images import decode_colour, decode_depth
from doughdata.recordings.pairing import Pair
from doughdata.recordings.pictures import Picture, PictureError, picture_of
from doughdata.recordings.protocol import Loss
from doughdata.recordings.source import Source
from doughdata.recordings.topics import ChosenTopics
from doughschemas import Intrinsics

__all__ = ["FrameReader", "RawFrame"]

MOST_WAITING = 128 << 20  # bytes of images that wait for their partner


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFrame:
    """A key frame as the sensor gave it."""

    stamp: int  # [ns]
    depth: UInt16[np.ndarray, "rows columns"] | Float32[np.ndarray, "rows columns"]  # units or [m]
    color: UInt8[np.ndarray, "rows columns 3"] | None
    encoding: str  # of depth
    unit_known: bool = True  # whether the type of message fixes the unit of 16-bit depth


@dataclass(slots=True)
class _Waiting:
    """The images of a pair, as far as they were read."""

    pair: Pair
    depth: Picture | None = None
    color: Picture | None = None
    failed: bool = False

    @property
    def ready(self) -> bool:
        """Whether both are there."""
        return self.failed or (
            self.depth is not None and (self.color is not None or self.pair.color is None)
        )

    @property
    def size(self) -> int:
        """Bytes held."""
        return sum(len(p.data) for p in (self.depth, self.color) if p is not None)


@dataclass(slots=True, kw_only=True)
class FrameReader:
    """Reads and decodes the images of chosen pairs. What cannot be decoded is kept in `bad`."""

    source: Source
    topics: ChosenTopics
    pairs: Sequence[Pair]
    intrinsics: Intrinsics
    bad: Counter[tuple[str, str]] = field(default_factory=Counter)  # (topic, reason) -> images
    _held: int = field(default=0, init=False)  # bytes of images that wait
    _encoding: str = field(default="", init=False)  # of the first depth image

    def __iter__(self) -> Iterator[RawFrame]:
        """Frames that could be decoded, by time.

        Raises:
            RecordingError: a size that differs from the calibration's or the other image's.
            DoughError: the images of an instant lie too far apart in the recording.
        """
        self.bad.clear()
        self._held, self._encoding = 0, ""
        queue = [_Waiting(pair) for pair in self.pairs]
        place = 0
        for _ in self._fill(queue):
            while place < len(queue) and queue[place].ready:
                frame = None if queue[place].failed else self._decode(queue[place])
                self._held -= queue[place].size
                queue[place].depth = queue[place].color = None
                place += 1
                if frame is not None:
                    yield frame

    @property
    def total(self) -> int:
        """Pairs that are wanted."""
        return len(self.pairs)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Images that could not be decoded in the last run."""
        return tuple(
            Loss(where=topic, count=count, unit="image", reason=reason)
            for (topic, reason), count in self.bad.items()
        )

    def _fill(self, queue: Sequence[_Waiting]) -> Iterator[None]:
        """Put images where they are waited for, in the order of the recording."""
        by_depth = {entry.pair.depth: entry for entry in queue}
        by_color: dict[int, list[_Waiting]] = {}
        for entry in queue:
            if entry.pair.color is not None:
                by_color.setdefault(entry.pair.color, []).append(entry)
        names = [self.topics.depth] + ([self.topics.color] if by_color else [])
        for message in self.source.messages([name for name in names if name]):
            is_depth = message.topic == self.topics.depth
            found = by_depth.get(message.number) if is_depth else None
            entries = ([found] if found else []) if is_depth else by_color.get(message.number, [])
            if not entries:
                continue
            picture: Picture | None = None
            try:
                picture = picture_of(message, self.source.topics[message.topic].kind)
            except PictureError as error:
                self.bad[message.topic, str(error)] += 1
            for entry in entries:
                self._put(entry, picture, is_depth=is_depth)
            yield

    def _put(self, entry: _Waiting, picture: Picture | None, *, is_depth: bool) -> None:
        if picture is None:
            entry.failed = True
            return
        if is_depth:
            entry.depth = picture
        else:
            entry.color = picture
        self._held += len(picture.data)
        if self._held > MOST_WAITING:
            raise RecordingError(
                f"images of the same instant lie too far apart in the recording ({self._held >> 20}"
                " MB wait for their partners): sort it by time first, or use --color-topic none"
            )

    def _decode(self, entry: _Waiting) -> RawFrame | None:
        """Both images, or None if one is damaged or shows nothing."""
        assert entry.depth is not None
        topic, color = self.topics.depth, None
        try:
            depth = decode_depth(entry.depth)
            if entry.color is not None:
                topic = self.topics.color or ""
                color = decode_colour(entry.color)
        except PictureError as error:
            self.bad[topic, str(error)] += 1
            return None
        self._check_sizes(depth.shape, None if color is None else color.shape)
        self._encoding = self._encoding or entry.depth.format
        if entry.depth.format != self._encoding:  # its numbers mean something else
            reason = f"has encoding {entry.depth.format[:40]!r}, those before {self._encoding!r}"
            self.bad[self.topics.depth, reason] += 1
            return None
        if not np.any(np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0) > 0):
            self.bad[self.topics.depth, "has no valid depth"] += 1
            return None
        return RawFrame(
            stamp=entry.pair.stamp,
            depth=depth,
            color=color,
            encoding=entry.depth.format,
            unit_known=entry.depth.unit_known,
        )

    def _check_sizes(self, depth: tuple[int, ...], color: tuple[int, ...] | None) -> None:
        if color is not None and color[:2] != depth:
            raise RecordingError(
                f"{self.topics.depth} is {depth[1]} x {depth[0]} pixels, {self.topics.color} "
                f"{color[1]} x {color[0]}: record depth aligned to colour "
                "(aligned_depth_to_color), or leave colour out with --color-topic none"
            )
        wanted = (self.intrinsics.height, self.intrinsics.width)
        if depth != wanted:
            raise RecordingError(
                f"{self.topics.depth} is {depth[1]} x {depth[0]} pixels, its calibration is for "
                f"{wanted[1]} x {wanted[0]}: --info-topic or --intrinsics FILE gives another one"
            )
