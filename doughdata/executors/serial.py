"""One shard after the other, in this process."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar, TypeVar

__all__ = ["SerialExecutor"]

Item = TypeVar("Item")
Result = TypeVar("Result")


class SerialExecutor:
    """Works here; the simplest executor and the judge of the others."""

    name: ClassVar[str] = "serial"

    def __init__(self, *, workers: int = 1) -> None:
        del workers  # there is only this process

    def __enter__(self) -> "SerialExecutor":
        return self

    def __exit__(self, *error: Any) -> None:
        pass

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Call `function` on every item, in order."""
        yield from map(function, items)
