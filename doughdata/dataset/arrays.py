"""Arrays in plain Zarr v3: one shard per array, one chunk per row, crc32c behind every chunk.

Reading goes straight to the standard bytes (shard index, one `pread`, crc32c, blosc); an array that
was written in another legal way is read by zarr-python instead.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt64

from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = ["ArraySpec", "ShardedArray", "padded_length", "write_arrays"]

MISSING_CHUNK = 2**64 - 1  # offset and size of a chunk that was not written (Zarr sharding codec)
INDEX_CODECS = ["bytes", "crc32c"]
CHUNK_CODECS = ["bytes", "blosc", "crc32c"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArraySpec:
    """An array to be written, and how."""

    data: np.ndarray
    axes: tuple[str, ...]  # names of the dimensions; the first is the row
    fill: int | float  # value of padding
    by_row: bool = True  # one chunk a row; False: all rows in one chunk, for small numbers
    shuffle: Literal["shuffle", "bitshuffle"] = "bitshuffle"
    attributes: Mapping[str, Any] = field(default_factory=dict)


def padded_length(length: int) -> int:
    """Next multiple of 8, at least 8: blosc's bitshuffle does nothing on other element counts."""
    return max(8, ceil(length / 8) * 8)


def write_arrays(
    folder: Path, arrays: Mapping[str, ArraySpec], *, attributes: Mapping[str, Any]
) -> None:
    """Write a Zarr v3 group with one shard per array.

    Raises:
        OSError: the disk is full or read-only.
    """
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    attributes = {"schema_version": SCHEMA_VERSION, **attributes}
    group = zarr.create_group(store=folder, zarr_format=3, attributes=attributes)
    for name, spec in arrays.items():
        chunk = (1 if spec.by_row else len(spec.data), *spec.data.shape[1:])
        group.create_array(
            name,
            data=np.ascontiguousarray(spec.data),
            chunks=chunk,
            shards=spec.data.shape,
            compressors=[BloscCodec(cname="zstd", clevel=3, shuffle=spec.shuffle), Crc32cCodec()],
            fill_value=spec.fill,
            dimension_names=spec.axes,
            attributes=dict(spec.attributes),
            config={"write_empty_chunks": True},  # so that every byte lies under a checksum
        )


class ShardedArray:
    """Read-only array on disk. Holds no open file, so it survives fork and pickling."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            meta = json.loads((folder / "zarr.json").read_bytes())
            self.shape: tuple[int, ...] = tuple(meta["shape"])
            self.dtype = np.dtype(meta["data_type"])
            self.attributes: dict[str, Any] = meta["attributes"]
            self.axes: tuple[str, ...] = tuple(meta.get("dimension_names") or ())
            self.chunk = _simple_chunk(meta, self.shape)
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise DamagedDatasetError(f"{folder}/zarr.json cannot be read: {error}") from error

    @cached_property
    def file(self) -> Path:
        """The one file that holds the data."""
        return self.folder.joinpath("c", *["0"] * len(self.shape))

    @property
    def num_chunks(self) -> int:
        """Chunks along the row axis."""
        return ceil(self.shape[0] / self.chunk[0]) if self.chunk else 0

    def row(self, row: int) -> np.ndarray:
        """One row.

        Raises:
            DamagedDatasetError: a checksum does not fit; the message names file and row.
        """
        if self.chunk is None:
            return np.asarray(self._plain[row])
        if self.chunk[0] > 1:
            return np.asarray(self._whole[row])
        return self.read_chunk(row)[0]

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Rows start..stop-1, stacked. Raises as `row` does."""
        if self.chunk is None:
            return np.asarray(self._plain[start:stop])
        if self.chunk[0] > 1:
            return self._whole[start:stop]
        if stop - start == 1:
            return self.read_chunk(start)
        out = np.empty((stop - start, *self.shape[1:]), self.dtype)
        for k in range(start, stop):
            out[k - start] = self.read_chunk(k)[0]
        return out

    def all(self) -> np.ndarray:
        """The whole array. Raises as `row` does."""
        return self.rows(0, self.shape[0])

    def read_chunk(self, number: int) -> np.ndarray:
        """One chunk, verified and decoded.

        Raises:
            DamagedDatasetError: missing, or a checksum does not fit.
        """
        assert self.chunk is not None
        offset, size = (int(value) for value in self.index[number])
        if offset == MISSING_CHUNK:
            return np.full(self.chunk, self._fill, self.dtype)
        try:
            return _decode(_verified(self._pread(offset, size)), self.dtype, self.chunk)
        except (RuntimeError, ValueError) as error:
            raise DamagedDatasetError(f"{self.file}: chunk {number} {error}") from error

    @cached_property
    def index(self) -> UInt64[np.ndarray, "chunks 2"]:
        """Byte offset and size of every chunk, from the end of the shard."""
        size = self.num_chunks * 16 + 4
        try:
            total = self.file.stat().st_size
        except OSError as error:
            raise DamagedDatasetError(f"{self.file} is missing") from error
        if total < size:
            raise DamagedDatasetError(f"{self.file} is too short for its shard index")
        try:
            data = _verified(self._pread(total - size, size))
        except ValueError as error:
            raise DamagedDatasetError(f"{self.file}: shard index {error}") from error
        return np.frombuffer(data, "<u8").reshape(-1, 2).astype(np.uint64)

    @cached_property
    def _whole(self) -> np.ndarray:
        """All rows of an array of small numbers, which lie in one chunk."""
        return self.read_chunk(0)

    @cached_property
    def _path(self) -> str:
        return str(self.file)

    @cached_property
    def _plain(self) -> Any:
        import zarr

        return zarr.open_array(self.folder, mode="r")

    @cached_property
    def _fill(self) -> int | float:
        value = json.loads((self.folder / "zarr.json").read_bytes())["fill_value"]
        return float(value) if isinstance(value, str) else value

    def _pread(self, offset: int, size: int) -> bytes:
        try:
            handle = os.open(self._path, os.O_RDONLY)
            try:
                return os.pread(handle, size, offset)
            finally:
                os.close(handle)
        except OSError as error:
            raise DamagedDatasetError(f"{self.file}: {error.strerror}") from error


def _simple_chunk(meta: Mapping[str, Any], shape: tuple[int, ...]) -> tuple[int, ...] | None:
    """Chunk shape if the array lies on disk exactly as `write_arrays` writes it, else None."""
    codecs = meta["codecs"]
    if len(codecs) != 1 or codecs[0]["name"] != "sharding_indexed":
        return None
    shard = codecs[0]["configuration"]
    chunk = tuple(shard["chunk_shape"])
    order = shard["codecs"][0].get("configuration", {}).get("endian", "little")
    plain = (
        meta["chunk_key_encoding"] == {"name": "default", "configuration": {"separator": "/"}}
        and tuple(meta["chunk_grid"]["configuration"]["chunk_shape"]) == shape
        and [codec["name"] for codec in shard["codecs"]] == CHUNK_CODECS
        and [codec["name"] for codec in shard["index_codecs"]] == INDEX_CODECS
        and shard.get("index_location", "end") == "end"
        and order == "little"
        and chunk[0] in (1, shape[0])
        and chunk[1:] == shape[1:]
    )
    return chunk if plain else None


def _verified(data: bytes) -> bytes:
    """The data without its trailing crc32c (little-endian); ValueError if it does not fit."""
    import google_crc32c

    if len(data) < 4 or google_crc32c.value(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise ValueError("does not fit its crc32c")
    return data[:-4]


def _decode(data: bytes, dtype: np.dtype, chunk: tuple[int, ...]) -> np.ndarray:
    from numcodecs import blosc  # pyright: ignore[reportAttributeAccessIssue] (compiled)

    return np.frombuffer(blosc.decompress(data), dtype, count=prod(chunk)).reshape(chunk)
