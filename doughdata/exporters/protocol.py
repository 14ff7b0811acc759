"""What an exporter is. They are found by name in the entry-point group `doughdata.exporters`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from doughdata.dataset import Dataset

__all__ = ["Exporter"]


@runtime_checkable
class Exporter(Protocol):
    """Writes scenes of a dataset in another format."""

    # To a type checker, `*_` and `**options` of type Any together mean "any further parameters".
    def export(
        self, dataset: Dataset, scenes: Sequence[int], out: Path, *_: Any, **options: Any
    ) -> tuple[Path, ...]:
        """Write scenes to a file or folder and return what was written.

        An implementation declares its options as keyword-only parameters with defaults; `doughdata
        export` reads their names off the signature.

        Raises:
            BadInputError: a scene, path or option that cannot be used.
            MissingLayerError: a layer that is needed was not made.
        """
        ...
