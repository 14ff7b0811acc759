"""First looks at a file: can it be read, and what is it?"""

from pathlib import Path

from doughdata.recordings.errors import RecordingError

__all__ = ["check_readable", "starts_with"]

PACKED = {  # how compressed files begin -> what unpacks them
    b"\x28\xb5\x2f\xfd": "zstd -d",
    b"\x1f\x8b": "gunzip",
    b"\xfd7zXZ": "unxz",
    b"BZh": "bunzip2",
    b"\x04\x22\x4d\x18": "lz4 -d",
    b"PK\x03\x04": "unzip",
}


def starts_with(path: Path, magic: bytes) -> bool:
    """Whether a file begins so; False if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(magic)) == magic
    except OSError:
        return False


def check_readable(path: Path) -> None:
    """Refuse what cannot be a recording.

    Raises:
        RecordingError: not there, not readable, empty, or compressed as a whole.
    """
    try:
        if path.is_dir():
            next(path.iterdir(), None)
            return
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    if not head:
        raise RecordingError(f"{path}: the file is empty")
    for magic, command in PACKED.items():
        if head.startswith(magic):
            raise RecordingError(f"{path}: the whole file is compressed; unpack it: {command}")
