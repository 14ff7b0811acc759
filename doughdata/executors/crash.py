"""What an executor yields in place of a result when a worker process died."""

from dataclasses import dataclass
from typing import Any

__all__ = ["WorkerCrash"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerCrash:
    """The worker that held `item` was killed (a signal, no memory), twice."""

    item: Any
    reason: str
