"""Arrays in plain Zarr v3: one shard per array, one chunk per row, crc32c behind every chunk.

Reading goes straight to the standard bytes (shard index, one read of a range, crc32c, blosc); an
array that was written in another legal way is read by zarr-python instead.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from math import ceil, prod
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt64

from doughdata.dataset.spool import BLOCK, CODEC, LEVEL, SpooledArray
from doughdata.dataset.store import LocalStore, Store
from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = [
    "ArraySpec",
    "ShardedArray",
    "blosc_settings",
    "encode_arrays",
    "padded_length",
    "spooled_files",
]

MISSING_CHUNK = 2**64 - 1  # offset and size of a chunk that was not written (Zarr sharding codec)
CRC_RESIDUE = 0x48674BC7  # crc32c of any data followed by their own crc32c, little-endian
INDEX_CODECS = ["bytes", "crc32c"]
CHUNK_CODECS = ["bytes", "blosc", "crc32c"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArraySpec:
    """An array to be written, and how."""

    data: np.ndarray
    axes: tuple[str, ...]  # names of the dimensions; the first is the row
    fill: int | float  # value of padding
    by_row: bool = True  # one chunk a row; False: all rows in one chunk, for small numbers
    attributes: Mapping[str, Any] = field(default_factory=dict)


def padded_length(length: int) -> int:
    """Next multiple of 8, at least 8: blosc's bitshuffle, which format 1.0 was written with, does
    nothing on other element counts.
    """
    return max(8, ceil(length / 8) * 8)


def blosc_settings() -> dict[str, Any]:
    """How chunks are compressed: LZ4 in large blocks, and bytes rather than bits shuffled, which
    are decoded faster than by zstd for a few bytes more (LOG.md has the figures).
    """
    return {"cname": CODEC, "clevel": LEVEL, "shuffle": "shuffle", "blocksize": BLOCK}


def encode_arrays(
    arrays: Mapping[str, ArraySpec | SpooledArray], *, attributes: Mapping[str, Any]
) -> dict[str, bytes]:
    """The files (name -> content) of a Zarr v3 group with one shard per array.

    Of a spooled array only the metadata: its shard is a file already, see `spooled_files`.
    """
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    files: dict[str, Any] = {}
    attributes = {"schema_version": SCHEMA_VERSION, **attributes}
    group = zarr.create_group(store=MemoryStore(files), zarr_format=3, attributes=attributes)
    for name, spec in arrays.items():
        if isinstance(spec, SpooledArray):
            _declare(group, name, spec)
            continue
        chunk = (1 if spec.by_row else len(spec.data), *spec.data.shape[1:])
        group.create_array(
            name,
            data=np.ascontiguousarray(spec.data),
            chunks=chunk,
            shards=spec.data.shape,
            compressors=[BloscCodec(**blosc_settings()), Crc32cCodec()],
            fill_value=spec.fill,
            dimension_names=spec.axes,
            attributes=dict(spec.attributes),
            config={"write_empty_chunks": True},  # so that every byte lies under a checksum
        )
    return {name: data.to_bytes() for name, data in sorted(files.items())}


def spooled_files(arrays: Mapping[str, ArraySpec | SpooledArray]) -> dict[str, Path]:
    """The shards of spooled arrays: name in the group -> file on this machine."""
    return {
        "/".join([name, "c", *["0"] * len(spec.shape)]): spec.file
        for name, spec in arrays.items()
        if isinstance(spec, SpooledArray)
    }


def _declare(group: Any, name: str, spec: SpooledArray) -> None:
    """The metadata of an array whose shard is there already."""
    from zarr.codecs import BloscCodec, Crc32cCodec

    group.create_array(
        name,
        shape=spec.shape,
        dtype=spec.dtype,
        chunks=(1, *spec.shape[1:]),
        shards=spec.shape,
        compressors=[BloscCodec(**blosc_settings()), Crc32cCodec()],
        fill_value=spec.fill,
        dimension_names=spec.axes,
        attributes=dict(spec.attributes),
    )


class ShardedArray:
    """Read-only array. Holds no open file or connection, so it survives fork and pickling.

    `folder` is relative to the store, or a folder on this machine if no store is given.
    """

    def __init__(self, folder: str | Path, *, store: Store | None = None) -> None:
        self._store = LocalStore("/") if store is None else store
        self.folder = str(Path(folder).absolute())[1:] if store is None else str(folder)
        try:
            meta = json.loads(self._store.read(f"{self.folder}/zarr.json"))
            self.shape: tuple[int, ...] = tuple(meta["shape"])
            self.dtype = np.dtype(meta["data_type"])
            self.attributes: dict[str, Any] = meta["attributes"]
            self.axes: tuple[str, ...] = tuple(meta.get("dimension_names") or ())
            self.chunk = _simple_chunk(meta, self.shape)
        except (KeyError, TypeError, ValueError) as error:
            raise DamagedDatasetError(f"{folder}/zarr.json cannot be read: {error}") from error
        self._data = "/".join([self.folder, "c", *["0"] * len(self.shape)])

    @property
    def file(self) -> Path:
        """The one file that holds the data of an array on this machine."""
        return self._store.local(self._data)

    @property
    def num_chunks(self) -> int:
        """Chunks along the row axis."""
        return ceil(self.shape[0] / self.chunk[0]) if self.chunk else 0

    @property
    def nbytes(self) -> int:
        """Memory [bytes] of what was read and is kept: the index, and arrays of small numbers."""
        return sum(self.__dict__[k].nbytes for k in ("index", "_whole") if k in self.__dict__)

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
        offset, size = self._ranges[number]
        if offset == MISSING_CHUNK:
            return np.full(self.chunk, self._fill, self.dtype)
        try:
            data = self._store.read_range(self._data, offset, offset + size)
            _verify(data)
            return _decode(data, self.dtype, self.chunk)
        except (RuntimeError, ValueError) as error:
            raise DamagedDatasetError(f"{self._data}: chunk {number} {error}") from error

    @cached_property
    def index(self) -> UInt64[np.ndarray, "chunks 2"]:
        """Byte offset and size of every chunk, from the end of the shard."""
        size = self.num_chunks * 16 + 4
        data = self._store.read_range(self._data, -size)
        if len(data) < size:
            raise DamagedDatasetError(f"{self._data} is too short for its shard index")
        try:
            _verify(data)
        except ValueError as error:
            raise DamagedDatasetError(f"{self._data}: shard index {error}") from error
        return np.frombuffer(data[:-4], "<u8").reshape(-1, 2).astype(np.uint64)

    @cached_property
    def _ranges(self) -> list[list[int]]:
        return self.index.tolist()

    @cached_property
    def _whole(self) -> np.ndarray:
        """All rows of an array of small numbers, which lie in one chunk."""
        return self.read_chunk(0)

    @cached_property
    def _plain(self) -> Any:
        import zarr

        if isinstance(self._store, LocalStore):
            return zarr.open_array(self._store.local(self.folder), mode="r")
        from doughdata.dataset.remote import RemoteStore

        assert isinstance(self._store, RemoteStore)
        return zarr.open_array(self._store.url(self.folder), mode="r")

    @cached_property
    def _fill(self) -> int | float:
        value = json.loads(self._store.read(f"{self.folder}/zarr.json"))["fill_value"]
        return float(value) if isinstance(value, str) else value


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


def _verify(data: bytes) -> None:
    """Raise ValueError if data do not fit the crc32c (little-endian) that they end with."""
    if len(data) < 4 or _crc32c()(data) != CRC_RESIDUE:
        raise ValueError("does not fit its crc32c")


def _decode(data: bytes, dtype: np.dtype, chunk: tuple[int, ...]) -> np.ndarray:
    """A chunk; blosc knows where its own data end, so that the crc32c may stay behind them."""
    return np.frombuffer(_blosc().decompress(data), dtype, count=prod(chunk)).reshape(chunk)


@cache
def _crc32c() -> Callable[[bytes], int]:
    from google_crc32c import value

    return value


@cache
def _blosc() -> Any:
    """blosc on the calling thread alone: its own threads cost a fifth of a frame's CPU time more,
    and would not survive a fork.
    """
    from numcodecs import blosc  # pyright: ignore[reportAttributeAccessIssue] (compiled)

    blosc.use_threads = False
    return blosc
