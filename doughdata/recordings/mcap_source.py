"""An MCAP file as a `Source`: ROS 2 (CDR), ROS 1 and Protobuf messages, by time of logging."""

import struct
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from doughdata.recordings.errors import RecordingError, UndecodableError
from doughdata.recordings.mcap_records import DamageError, parsed_chunk, unpacked
from doughdata.recordings.mcap_scan import McapScan, scan_mcap
from doughdata.recordings.protocol import Loss, OnProgress, silent
from doughdata.recordings.source import Message, Topic
from doughdata.registry import require_package
from doughschemas import DoughError

__all__ = ["McapSource"]

KEPT = 64 << 20  # bytes of unpacked chunks that are kept; one chunk is always
LAST_TIME = (1 << 63) - 1  # [ns]; the format allows later ones, arrays of time do not
Decode = Callable[[bytes], Any]


class McapSource:
    """Reads a file through once; then gives its messages, any number of times.

    Raises:
        RecordingError: it is no MCAP file.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, *, on_progress: OnProgress | None = None) -> None:
        self.path = path
        report = on_progress or silent
        try:
            self._scan: McapScan = scan_mcap(
                path, lambda done, total: report("reading", done, total)
            )
        except DamageError as error:
            raise RecordingError(f"{path}: {error}") from error
        self._chunks: OrderedDict[int, bytes] = OrderedDict()
        self._decoders: dict[int, Decode] = {}
        self._topics = self._found_topics()

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics of all channels; of two channels of one topic the first names the type."""
        return self._topics

    def _found_topics(self) -> dict[str, Topic]:
        counts = Counter(self._scan.index.channel)
        topics: dict[str, Topic] = {}
        for number, channel in sorted(self._scan.channels.items()):
            schema = self._scan.schemas.get(channel.schema_id)
            have = topics.get(channel.topic)
            topics[channel.topic] = Topic(
                name=channel.topic,
                schema=have.schema if have else schema.name if schema else "",
                encoding=channel.message_encoding,
                count=counts[number] + (have.count if have else 0),
            )
        return topics

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Messages that the file says it has and that are not there, or the damaged places."""
        damage, expected = self._scan.damage, self._scan.expected
        if not damage:
            return ()
        reason = "; ".join(damage[:3]) + (f" and {len(damage) - 3} more" if len(damage) > 3 else "")
        known = expected is not None and expected > self.num_messages
        count = (expected or 0) - self.num_messages if known else len(damage)
        unit = "message" if known else "damaged place"
        return (Loss(where=self.path.name, count=count, unit=unit, reason=reason),)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd without costing a message."""
        return tuple(self._scan.warnings)

    @property
    def num_messages(self) -> int:
        """Messages that can be read and whose channel is known."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def num_expected(self) -> int | None:
        """Messages by the file's own statistics."""
        return self._scan.expected

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics by time of logging, equal times in the order of the file.

        Raises:
            RecordingError: the file has changed since it was read first.
        """
        for message, data in self.raw_messages(topics):
            yield self._decoded(message, data)

    def raw_messages(self, topics: Collection[str]) -> Iterator[tuple[Message, bytes]]:
        """The same messages, not decoded, with their bytes."""
        index, channels = self._scan.index, self._scan.channels
        if not len(index):
            return
        wanted = [number for number, channel in channels.items() if channel.topic in topics]
        rows = np.flatnonzero(np.isin(np.frombuffer(index.channel, np.uint16), wanted))
        rows = rows[np.argsort(np.frombuffer(index.log_time, np.uint64)[rows], kind="stable")]
        numbers: Counter[str] = Counter()
        with self.path.open("rb") as file:
            for row in rows.tolist():
                channel = channels[index.channel[row]]
                data = self._data(file, index.chunk[row], index.start[row], index.length[row])
                yield (
                    Message(
                        topic=channel.topic,
                        number=numbers[channel.topic],
                        log_time=min(index.log_time[row], LAST_TIME),
                        value=None,
                        channel=channel.id,
                    ),
                    data,
                )
                numbers[channel.topic] += 1
        self._chunks.clear()

    def _decoded(self, message: Message, data: bytes) -> Message:
        try:
            return replace(message, value=self._decoder(message.channel)(data))
        except DoughError:
            raise
        except Exception as problem:  # any bytes may come: decoders fail in any way
            name = "too short" if isinstance(problem, struct.error) else type(problem).__name__
            return replace(message, error=f"cannot be decoded: {name}")

    def _data(self, file: BinaryIO, chunk: int, start: int, length: int) -> bytes:
        if chunk == 0:
            file.seek(start)
            return file.read(length)
        return self._chunk(file, chunk)[start : start + length]

    def _chunk(self, file: BinaryIO, start: int) -> bytes:
        """An unpacked chunk; the last few are kept, since topics interleave."""
        if start not in self._chunks:
            file.seek(start)
            try:
                data = unpacked(parsed_chunk(file.read(self._scan.chunk_lengths[start])))
            except DamageError as error:
                raise RecordingError(f"{self.path} changed while it was read: {error}") from error
            while self._chunks and sum(map(len, self._chunks.values())) + len(data) > KEPT:
                self._chunks.popitem(last=False)
            self._chunks[start] = data
        self._chunks.move_to_end(start)
        return self._chunks[start]

    def _decoder(self, number: int) -> Decode:
        """Of a channel. Raises UndecodableError if nobody decodes its messages."""
        if number in self._decoders:
            return self._decoders[number]
        channel = self._scan.channels[number]
        schema = self._scan.schemas.get(channel.schema_id)
        for factory in _factories():
            try:
                decode = factory.decoder_for(channel.message_encoding, schema)
            except Exception as error:  # any bytes may come: the library fails in any way
                reason = f"has a damaged definition of its type {schema.name if schema else ''!r}"
                raise UndecodableError(self.path, channel.topic, reason) from error
            if decode is not None:
                self._decoders[number] = decode
                return decode
        reason = (
            f"has messages in encoding {channel.message_encoding!r} with a schema in "
            f"{schema.encoding if schema else 'none'!r}; known are cdr with ros2msg, ros1 with "
            "ros1msg, and protobuf"
        )
        raise UndecodableError(self.path, channel.topic, reason)


def _factories() -> list[Any]:
    """One decoder factory an encoding; each is a library of its own."""
    modules = ("mcap_ros2.decoder", "mcap_ros1.decoder", "mcap_protobuf.decoder")
    return [require_package(name, extra="mcap").DecoderFactory() for name in modules]
