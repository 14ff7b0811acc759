"""Options and progress that the `doughnet` commands share."""

import os
from types import TracebackType
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

__all__ = ["SensorOption", "ShareBar", "ThreadsOption", "WeightsOption", "use_threads"]

WeightsOption = Annotated[
    str | None,
    typer.Option(
        "--weights",
        metavar="DIR",
        help="Folder that `doughnet train` made, its --out (default: the shipped weights).",
    ),
]
SensorOption = Annotated[
    str, typer.Option("--sensor", metavar="SENSOR", help="Depth layer that the model looks at.")
]
ThreadsOption = Annotated[
    int | None,
    typer.Option("--threads", min=1, metavar="N", help="Threads of the arithmetic (default: all)."),
]


class ShareBar:
    """A bar on stderr that fills from 0 to 1, with the time left and the latest numbers.

    It shows from the first `advance` on: a mistake that is found before leaves one line alone.
    """

    def __init__(self, title: str, *, quiet: bool = False) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%  {task.fields[numbers]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(stderr=True, quiet=quiet),
            refresh_per_second=2,
        )
        self._task = self._progress.add_task(title, total=1.0, numbers="")

    def __enter__(self) -> "ShareBar":
        return self

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def advance(self, progress: float, values: dict[str, float] | None = None) -> None:
        """The share that is done, and numbers worth a look."""
        self._progress.start()
        numbers = "  ".join(f"{name} {value:.4f}" for name, value in (values or {}).items())
        self._progress.update(self._task, completed=min(progress, 1.0), numbers=numbers)


def use_threads(threads: int | None) -> None:
    """Compute with this many threads; None leaves the choice to the library.

    They sleep while they wait: where other work runs, spinning ones made a frame 30 times as dear.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when torch is imported
    if threads is not None:
        from doughnet import compute_threads

        compute_threads(threads)
