"""A bar per stage on stderr: scenes done, scenes left, time left."""

from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

__all__ = ["StageBars"]


class StageBars:
    """Shows the stages of a run; hand it to the pipeline as its listener."""

    def __init__(self, *, quiet: bool = False) -> None:
        console = Console(stderr=True, quiet=quiet)
        self._progress = Progress(
            TextColumn("{task.description:>18}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("scenes, {task.fields[left]} left"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            refresh_per_second=4,
        )
        self._tasks: dict[str, TaskID] = {}
        self._totals: dict[str, tuple[int, int]] = {}

    def __enter__(self) -> "StageBars":
        self._progress.start()
        return self

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def start(self, stage: str, *, total: int, done: int) -> None:
        """A stage begins with `done` of its `total` scenes already committed."""
        self._totals[stage] = (total, done)
        self._tasks[stage] = self._progress.add_task(
            stage, total=total, completed=done, left=total - done
        )

    def advance(self, stage: str, scenes: int) -> None:
        """More scenes of a stage are committed."""
        total, done = self._totals[stage]
        self._totals[stage] = (total, done + scenes)
        self._progress.update(
            self._tasks[stage], completed=done + scenes, left=max(0, total - done - scenes)
        )
