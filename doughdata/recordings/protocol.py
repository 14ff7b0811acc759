"""What a converter is. They are found by name in the entry-point group `doughdata.converters`."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from doughdata.recordings.errors import one_line

__all__ = ["Conversion", "Converter", "Loss", "OnProgress", "silent"]

OnProgress = Callable[[str, int, int], None]  # what is being done, how much is done, of how much


def silent(what: str, done: int, total: int) -> None:
    """An `OnProgress` that shows nothing."""
    del what, done, total


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Something of the source that did not come through, and why."""

    where: str  # topic, chunk or file
    count: int  # messages, images or scenes; what `unit` says
    unit: str
    reason: str  # one line

    def __str__(self) -> str:
        plural = "" if self.count == 1 else "s"
        return one_line(f"{self.where}: {self.count} {self.unit}{plural} lost ({self.reason})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """What a conversion did. Losses make `doughdata convert` exit with 1 unless they were allowed.

    `warnings` are lines for the user; `figures` are numbers for `--json`.
    """

    dataset: str
    scenes: tuple[int, ...]  # scene_index of what is in the dataset now
    frames: int  # key frames that came through
    losses: tuple[Loss, ...] = ()
    warnings: tuple[str, ...] = ()
    figures: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for `--json`."""
        return asdict(self)


@runtime_checkable
class Converter(Protocol):
    """Turns one kind of file or folder into scenes of a dataset."""

    def takes(self, path: Path) -> bool:
        """Whether this looks like a file or folder of its kind; cheap, and never raises."""
        ...

    # To a type checker, `*_` and `**options` of type Any together mean "any further parameters".
    def convert(
        self,
        path: Path,
        dataset: str,
        *_: Any,
        on_progress: OnProgress | None = None,
        **options: Any,
    ) -> Conversion:
        """Read `path` and commit its scenes to the dataset, which is made if it is not there.

        An implementation declares its options as keyword-only parameters with defaults; `doughdata
        convert` reads their names off the signature and passes on what the user gave. All or
        nothing: when it raises, nothing was committed and no new dataset is left behind.

        Raises:
            DoughError: the source cannot be used as it is; one line says why and what to do.
        """
        ...
