"""The exception tree. A message says what was expected, what came and what to do, in one line."""

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any

__all__ = [
    "BadInputError",
    "DamagedDatasetError",
    "DatasetError",
    "DoughError",
    "MissingLayerError",
    "MissingPackageError",
    "SceneError",
    "SimulationError",
    "UnknownNameError",
    "VersionError",
]


class DoughError(Exception):
    """Base of every error that doughdata raises on purpose; survives the way out of a worker."""

    def __reduce__(self) -> tuple[Callable[..., "DoughError"], tuple[type, str, dict[str, Any]]]:
        return _restored, (type(self), str(self), dict(self.__dict__))


def _restored(kind: type["DoughError"], message: str, state: dict[str, Any]) -> "DoughError":
    """An error as it was pickled, whatever its own `__init__` asks for."""
    error = kind.__new__(kind, message)
    Exception.__init__(error, message)
    error.__dict__.update(state)
    return error


class BadInputError(DoughError):
    """An argument or a file that cannot be used as it is."""


class UnknownNameError(BadInputError):
    """A plug-in, family, stage or layer name that nobody registered."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        near = get_close_matches(name, self.known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        super().__init__(
            f"unknown {kind} {name!r}{hint} (known: {', '.join(self.known) or 'none'})"
        )


class SceneError(BadInputError):
    """A scene outside its physical limits, or a scene JSON with a wrong field."""


class MissingPackageError(DoughError):
    """An optional package that is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f'{package} is needed here: pip install "doughdata[{extra}]"')


class SimulationError(DoughError):
    """A simulation that left its domain, became NaN or broke its time-step limit."""


class DatasetError(DoughError):
    """A folder that is not a dataset, or a dataset that does not fit the request."""


class MissingLayerError(DatasetError):
    """A layer that was not made yet; the message names the command that makes it."""


class DamagedDatasetError(DatasetError):
    """A committed file that is missing or has changed."""


class VersionError(DatasetError):
    """A dataset whose schema version this release cannot read."""
