"""Where shards are worked on: here (`serial`), on this machine's cores (`processes`)."""

from doughdata.executors.crash import WorkerCrash

__all__ = ["WorkerCrash"]
