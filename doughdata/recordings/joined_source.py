"""Several files of one recording as one `Source`, as `ros2 bag record` splits them."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from heapq import merge

from doughdata.recordings.protocol import Loss
from doughdata.recordings.rosbag2 import METADATA, Folder
from doughdata.recordings.source import Message, Source, Topic

__all__ = ["JoinedSource"]


class JoinedSource:
    """The messages of all parts by time of logging; what the folder promises must be there."""

    def __init__(self, parts: Sequence[Source], folder: Folder) -> None:
        self._parts, self._folder = parts, folder
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
        """Of all parts; else messages that the folder promises and no part holds."""
        found = tuple(loss for part in self._parts for loss in part.losses)
        found = (*self._folder.losses, *found)
        promised = self._folder.num_expected
        if found or promised is None or promised == self.num_messages:
            return found
        reason = f"{METADATA} says {promised} messages, the files hold {self.num_messages}"
        missing = promised - self.num_messages
        unit = "message" if missing > 0 else "damaged place"
        where = "the folder"
        return (Loss(where=where, count=max(missing, 1), unit=unit, reason=reason),)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the folder and all parts."""
        found = (warning for part in self._parts for warning in part.warnings)
        return (*self._folder.warnings, *found)

    @property
    def num_messages(self) -> int:
        """Messages that can be read."""
        return sum(part.num_messages for part in self._parts)

    @property
    def num_expected(self) -> int | None:
        """What the folder claims, else the sum of its parts; None if one does not say."""
        if self._folder.num_expected is not None:
            return self._folder.num_expected
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
