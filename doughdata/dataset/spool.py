"""Arrays of images that are too large for memory: rows go to a file as they come.

The file is the one shard of a Zarr v3 array, exactly as `arrays.encode_arrays` would write it: one
chunk a row (bytes, blosc, crc32c), then the index of offsets and sizes with its crc32c.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from doughschemas import BadInputError

__all__ = ["RowSpool", "SpooledArray"]

CODEC, LEVEL = "lz4hc", 5  # of blosc, for all arrays
BLOCK = 2**18  # [bytes] that blosc compresses at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class SpooledArray:
    """A finished spool: what `encode_arrays` needs to take its file as the array's only shard."""

    file: Path
    shape: tuple[int, ...]
    dtype: np.dtype
    axes: tuple[str, ...]
    fill: int
    attributes: Mapping[str, Any] = field(default_factory=dict)
    shuffle: str = "shuffle"


class RowSpool:
    """Appends rows of equal shape and dtype to a file. Use it as a context manager."""

    def __init__(self, file: Path, *, dtype: np.dtype, axes: tuple[str, ...]) -> None:
        self.file, self.dtype, self.axes = file, np.dtype(dtype), axes
        self._shape: tuple[int, ...] | None = None
        self._index: list[tuple[int, int]] = []
        self._place = 0
        self._out = file.open("wb")

    def __enter__(self) -> "RowSpool":
        return self

    def __exit__(self, *error: object) -> None:
        self._out.close()

    def __len__(self) -> int:
        """Rows so far."""
        return len(self._index)

    def add(self, row: np.ndarray) -> None:
        """Append one row.

        Raises:
            BadInputError: its shape differs from the first row's.
        """
        if self._shape is None:
            self._shape = row.shape
        if row.shape != self._shape or row.dtype != self.dtype:
            raise BadInputError(
                f"rows of {self.file.name} have shape {self._shape}, got {row.dtype} {row.shape}"
            )
        chunk = _checked(_compressed(np.ascontiguousarray(row)))
        self._out.write(chunk)
        self._index.append((self._place, len(chunk)))
        self._place += len(chunk)

    def finish(self, *, attributes: Mapping[str, Any] | None = None) -> SpooledArray:
        """Write the index and close the file.

        Raises:
            BadInputError: no row was added.
        """
        if self._shape is None:
            raise BadInputError(f"{self.file.name}: no row was written")
        self._out.write(_checked(np.array(self._index, "<u8").tobytes()))
        self._out.close()
        return SpooledArray(
            file=self.file,
            shape=(len(self._index), *self._shape),
            dtype=self.dtype,
            axes=self.axes,
            fill=0,
            attributes=dict(attributes or {}),
        )


def _compressed(row: np.ndarray) -> bytes:
    from numcodecs import blosc  # pyright: ignore[reportAttributeAccessIssue] (compiled)

    return blosc.compress(row, CODEC.encode(), LEVEL, blosc.SHUFFLE, BLOCK)


def _checked(data: bytes) -> bytes:
    """The data and their crc32c."""
    import google_crc32c

    return data + google_crc32c.value(data).to_bytes(4, "little")
