"""One spawned process a core; never forks, because Taichi hangs after a fork."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, ClassVar, TypeVar

from doughdata.executors.crash import WorkerCrash

__all__ = ["ProcessExecutor"]

Item = TypeVar("Item")
Result = TypeVar("Result")


class ProcessExecutor:
    """Spawned worker processes. A worker that dies costs only the item it held.

    The pool lives from `__enter__` to `__exit__`, so that kernels are compiled once a worker.
    """

    name: ClassVar[str] = "processes"

    def __init__(self, *, workers: int | None = None) -> None:
        self.workers = workers or os.cpu_count() or 1
        self._pool: ProcessPoolExecutor | None = None
        self._foreign: set[int | None] = set()

    def __enter__(self) -> "ProcessExecutor":
        self._foreign = {child.pid for child in multiprocessing.active_children()}
        return self

    def __exit__(self, *error: Any) -> None:
        # An error lets running items end; only Ctrl-C and the like do not wait for them.
        self._stop(kill=error[0] is not None and not issubclass(error[0], Exception))

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[Result | WorkerCrash]:
        """Call `function` (picklable) on every item; results come in order of completion."""
        left = yield from self._attempt(function, list(items), workers=self.workers)
        for item in left:  # a worker died: find out which item it was, one at a time
            again = yield from self._attempt(function, [item], workers=1)
            if again:
                yield WorkerCrash(item=item, reason="the worker process died (signal or memory)")

    def _attempt(
        self, function: Callable[[Item], Result], items: list[Item], *, workers: int
    ) -> Iterator[Any]:
        """Yield the results; return the items that were lost with a broken pool."""
        pool = self._started(workers)
        futures = {pool.submit(function, item): item for item in items}
        lost = []
        for future in as_completed(futures):
            try:
                result = future.result()
            except BrokenProcessPool:
                lost.append(futures[future])
            else:
                yield result
        if lost:
            self._stop(kill=True)
        return lost

    def _started(self, workers: int) -> ProcessPoolExecutor:
        if self._pool is None:
            with _quiet_tracker():
                self._pool = ProcessPoolExecutor(
                    workers,
                    mp_context=multiprocessing.get_context("spawn"),
                    initializer=_quiet_worker,
                )
        return self._pool

    def _stop(self, *, kill: bool) -> None:
        if self._pool is None:
            return
        if kill:
            for child in multiprocessing.active_children():
                if child.pid not in self._foreign:
                    child.kill()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None


@contextmanager
def _quiet_tracker() -> Iterator[None]:
    """Start Python's resource tracker without its warning.

    It frees the semaphores of workers that were killed while they started, and tells the user so.
    """
    before = os.environ.get("PYTHONWARNINGS")
    rule = "ignore:resource_tracker:UserWarning"
    os.environ["PYTHONWARNINGS"] = f"{before},{rule}" if before else rule
    try:
        resource_tracker.ensure_running()
        yield
    finally:
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def _quiet_worker() -> None:
    """Ctrl-C is the parent's business; one thread a worker, the cores are shared."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
