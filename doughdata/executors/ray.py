"""Many machines: Ray schedules shards over a cluster, and does those of a lost node again.

With `RAY_ADDRESS` set a running cluster is used (`ray start --head` made it); without, Ray starts
on this machine and ends with the run. Every node needs doughdata, and its own way to the dataset:
credentials of an object store are read from the node's environment and never sent.
"""

import logging
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, TypeVar

from doughdata.executors.crash import WorkerCrash
from doughdata.registry import require_package
from doughschemas import DoughError

__all__ = ["RayExecutor"]

Item = TypeVar("Item")
Result = TypeVar("Result")

TRIES = 2  # of an item whose worker died; as for the executor `processes`
NODE_TRIES = 10  # of an item whose whole machine was lost, which says nothing about the item
KNOCK_SECONDS = 10.0  # to wait for a cluster's answer
AHEAD = 2  # items a core that Ray knows of at a time: enough for it to see that more nodes help
QUIET = {  # what Ray reads when it is imported and started, unless the user has set it
    "RAY_USAGE_STATS_ENABLED": "0",  # no reports home
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # no warning about a change to come
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",  # no words on stdout when a worker dies: we tell it
}


class RayExecutor:
    """Ray tasks, one core each; a worker process is used again, so kernels are compiled once.

    Args:
        workers: items in work at a time; None = as many as the cluster has cores, also when it
            grows. Without a cluster it is the number of cores that Ray uses here.
    """

    name: ClassVar[str] = "ray"

    def __init__(self, *, workers: int | None = None) -> None:
        self.workers = workers
        self._ray: Any = None
        self._own = False  # whether this object connected, and has to disconnect

    def __enter__(self) -> "RayExecutor":
        with _quiet_environment():
            self._ray = require_package("ray", extra="ray")
            if not self._ray.is_initialized():
                self._own = True
                self._connect()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._own:
            self._ray.shutdown()
        self._ray, self._own = None, False

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[Result | WorkerCrash]:
        """Call `function` (picklable) on every item; results come in order of completion."""
        ray = self._ray
        call = ray.remote(num_cpus=1, max_retries=0)(_call)
        shared = ray.put(function)  # sent to a node once, not with every item
        waiting = iter(items)
        running: dict[Any, _Try] = {}
        while True:
            for item in waiting:
                running[call.remote(shared, item)] = _Try(item)
                if len(running) >= self._most():
                    break
            if not running:
                return
            (ready,), _ = ray.wait(list(running), num_returns=1)
            attempt = running.pop(ready)
            try:
                yield ray.get(ready)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None  # the function's own error, as from any executor
            except _lost(ray) as error:
                if attempt.goes_on(node=_node_lost(ray, error)):
                    running[call.remote(shared, attempt.item)] = attempt
                else:
                    reason = "the worker process died (signal or memory)"
                    yield WorkerCrash(item=attempt.item, reason=reason)

    def _connect(self) -> None:
        address = os.environ.get("RAY_ADDRESS") or None
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if address is None:
            options |= {"num_cpus": self.workers, "include_dashboard": False}
        try:
            _knock(address)
            self._ray.init(address=address or "local", **options)
        except (OSError, RuntimeError, ValueError) as error:
            where = f"RAY_ADDRESS={address}" if address else "on this machine"
            raise DoughError(
                f"cannot reach Ray ({where}): {' '.join(str(error).split())}; "
                "start it with `ray start --head`, or use --executor processes"
            ) from error

    def _most(self) -> int:
        """Items that Ray may know of now; a cluster may grow or shrink meanwhile."""
        if self.workers is not None:
            return self.workers
        return max(1, AHEAD * int(self._ray.cluster_resources().get("CPU", 1)))


class _Try:
    """An item that Ray works on, and how often its worker or node was lost."""

    def __init__(self, item: Any) -> None:
        self.item, self.crashes, self.nodes = item, 0, 0

    def goes_on(self, *, node: bool) -> bool:
        """Count a loss; whether to try again."""
        self.nodes += node
        self.crashes += not node
        return self.crashes < TRIES and self.nodes < NODE_TRIES


def _knock(address: str | None) -> None:
    """Raise OSError if nobody listens at host:port; Ray itself would try for two minutes."""
    host, separator, port = (address or "").rpartition("://")[2].rpartition(":")
    if separator and port.isdigit():
        socket.create_connection((host, int(port)), timeout=KNOCK_SECONDS).close()


def _call(function: Callable[[Item], Result], item: Item) -> Result:
    """Runs in a worker; Ray hands the shared function over by itself."""
    return function(item)


def _lost(ray: Any) -> tuple[type[Exception], ...]:
    """What Ray raises when a worker, its node or its result is gone."""
    known = ray.exceptions
    return (
        known.WorkerCrashedError,
        known.OutOfMemoryError,
        known.LocalRayletDiedError,
        known.NodeDiedError,
        known.ObjectLostError,
    )


def _node_lost(ray: Any, error: Exception) -> bool:
    """Whether not the item's worker alone, but its whole machine went away."""
    known = ray.exceptions
    kinds = (known.NodeDiedError, known.LocalRayletDiedError, known.ObjectLostError)
    return isinstance(error, kinds)


@contextmanager
def _quiet_environment() -> Iterator[None]:
    """Set `QUIET` for a while."""
    added = [name for name in QUIET if name not in os.environ]
    os.environ.update({name: QUIET[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
