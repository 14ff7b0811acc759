"""Several files of one recording as one `Source`, as `ros2 bag record` splits them."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from heapq import merge

from doughdata.recordings.protocol import Loss
from doughdata.recordings.source import Message, Source, Topic

__all__ = ["JoinedSource"]


class JoinedSource:
    """The messages of all parts by time of logging."""

    def __init__(self, parts: Sequence[Source]) -> None:
        self._parts = parts
        self._topics: dict[str, Topic] = {}
        for part in parts:
            for name, topic in part.topics.items():
                have = self._topics.get(name)
                count = topic.count + (have.count if have else 0)
                self._topics[name] = replace(have or topic, count=count)

    @property
    def topics(self) -> dict[str, Topic]:
        """Topic name -> topic."""
        return self._topics

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Of all parts."""
        return tuple(loss for part in self._parts for loss in part.losses)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of all parts."""
        return tuple(warning for part in self._parts for warning in part.warnings)

    @property
    def num_messages(self) -> int:
        """Messages that can be read."""
        return sum(part.num_messages for part in self._parts)

    @property
    def num_expected(self) -> int | None:
        """Sum of what the parts claim; None if one of them does not say."""
        counts = [part.num_expected for part in self._parts]
        return None if None in counts else sum(count for count in counts if count is not None)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics by time of logging."""
        numbers: Counter[str] = Counter()
        streams = [part.messages(topics) for part in self._parts]
        for message in merge(*streams, key=lambda message: message.log_time):
            number = numbers[message.topic]
            numbers[message.topic] += 1
            yield replace(message, number=number)
