"""The error of this package."""

from doughschemas import DoughError

__all__ = ["RecordingError"]


class RecordingError(DoughError):
    """A recording that cannot be used as it is; no bad usage of the command, so it exits with 1."""
