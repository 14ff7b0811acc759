"""The error of this package, and text that is safe to print."""

from doughschemas import DoughError

__all__ = ["RecordingError", "UndecodableError", "one_line"]


def one_line(text: str) -> str:
    """Text with each run of white space as one blank and what cannot be printed as `?`.

    Names of topics and frames come from the recording: they may hold line breaks and terminal
    codes.
    """
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


class RecordingError(DoughError):
    """A recording that cannot be used as it is; no bad usage of the command, so it exits with 1."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class UndecodableError(RecordingError):
    """A topic whose messages nobody decodes."""

    def __init__(self, recording: object, topic: str, reason: str) -> None:
        super().__init__(f"{recording}: topic {topic} {reason}")
        self.reason = one_line(reason)
