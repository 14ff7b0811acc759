"""What the rest needs of a recording: its topics, its messages in time order, and what was lost."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from doughdata.recordings.protocol import Loss

__all__ = ["Message", "Source", "Topic"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A stream of messages of one type."""

    name: str
    schema: str  # full name of the type, e.g. "sensor_msgs/msg/Image"
    encoding: str  # of its messages: cdr, ros1, protobuf
    count: int  # messages that can be read

    @property
    def kind(self) -> str:
        """Last word of the type's name; equal in ROS 1, ROS 2 and Foxglove's own schemas."""
        return self.schema.replace(".", "/").rpartition("/")[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One message. `value` is decoded, or None if it could not be; then `error` says why."""

    topic: str
    number: int  # 0, 1, ... within its topic, in the order in which `messages` gives them
    log_time: int  # [ns]
    value: Any
    error: str = ""
    channel: int = 0  # of the container, where it has such numbers


@runtime_checkable
class Source(Protocol):
    """A recording that was read through once, so that all damage is known."""

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Topic name -> topic."""
        ...

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the container lost, before any message was decoded."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines for the user."""
        ...

    @property
    def num_messages(self) -> int:
        """Messages that can be read, of all topics."""
        ...

    @property
    def num_expected(self) -> int | None:
        """Messages that the recording itself claims to hold; None = it does not say."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics by time of logging; may be called any number of times."""
        ...
