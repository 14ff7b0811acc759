"""A ROS 1 bag, or rosbag2 with sqlite3 storage or compression, as a `Source` through rosbags."""

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.protocol import Loss, OnProgress, silent
from doughdata.recordings.source import Message, Topic

__all__ = ["BagSource"]

STEP = 256  # messages between two reports of progress


class BagSource:
    """Reads a bag through once; then gives its messages, any number of times.

    Raises:
        RecordingError: it is no bag, or its index is missing or damaged.
    """

    def __init__(self, path: Path, *, on_progress: OnProgress | None = None) -> None:
        self.path = path
        self._losses: list[Loss] = []
        counts: Counter[str] = Counter()
        report = on_progress or silent
        with self._reader() as reader:
            self.num_expected: int | None = reader.message_count
            schemas = {c.topic: c.msgtype for c in reader.connections}
            try:
                for number, (connection, _, _) in enumerate(reader.messages()):
                    counts[connection.topic] += 1
                    if number % STEP == 0:
                        report("reading", number, reader.message_count)
            except Exception as error:  # any bytes may come: the library fails in any way
                self._lose(counts, f"{type(error).__name__}: {error}")
            else:
                if counts.total() != reader.message_count:
                    self._lose(counts, "fewer messages than its index says")
        self._topics = {
            name: Topic(name=name, schema=schema, encoding="ros", count=counts[name])
            for name, schema in schemas.items()
        }

    @property
    def topics(self) -> dict[str, Topic]:
        """Topic name -> topic."""
        return self._topics

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be read."""
        return tuple(self._losses)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What cannot be known of any bag."""
        return ("bags have no checksums: damage inside messages is not noticed",)

    @property
    def num_messages(self) -> int:
        """Messages that can be read, of all topics."""
        return sum(topic.count for topic in self._topics.values())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics by time of logging."""
        numbers: Counter[str] = Counter()
        with self._reader() as reader:
            wanted = [c for c in reader.connections if c.topic in topics]
            if not wanted:
                return
            left = Counter(
                {name: self._topics[name].count for name in topics if name in self._topics}
            )
            stream = reader.messages(connections=wanted)
            while left.total():
                try:
                    connection, time, raw = next(stream)
                except Exception:  # where the first pass ended; told in `losses`
                    return
                number = numbers[connection.topic]
                numbers[connection.topic] += 1
                left[connection.topic] -= 1
                yield self._message(reader, connection, number, time, raw)

    def _message(
        self, reader: AnyReader, connection: Any, number: int, time: int, raw: bytes
    ) -> Message:
        value, error = None, ""
        try:
            value = reader.deserialize(raw, connection.msgtype)
        except Exception as problem:  # any bytes may come
            error = f"cannot be decoded: {type(problem).__name__}"
        return Message(
            topic=connection.topic, number=number, log_time=time, value=value, error=error
        )

    @contextmanager
    def _reader(self) -> Iterator[AnyReader]:
        try:
            reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        except Exception as error:  # any bytes may come: the library fails in any way
            raise self._refusal(error) from error
        try:
            yield reader
        finally:
            reader.close()

    def _refusal(self, error: Exception) -> RecordingError:
        text = " ".join(str(error).split())
        return RecordingError(
            f"{self.path}: cannot be opened as a bag ({text}); `rosbag reindex` or "
            "`ros2 bag reindex` repairs one that was cut short"
        )

    def _lose(self, counts: Counter[str], reason: str) -> None:
        lost = max((self.num_expected or 0) - counts.total(), 1)
        text = " ".join(reason.split())
        self._losses.append(Loss(where=self.path.name, count=lost, unit="message", reason=text))
