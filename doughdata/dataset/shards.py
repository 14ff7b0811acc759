"""One committed layer of one shard: its rows, arrays and tables."""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset.arrays import ArraySpec, ShardedArray
from doughdata.dataset.commits import CommitRecord
from doughdata.dataset.spool import SpooledArray
from doughdata.dataset.store import Store
from doughdata.dataset.supplements import with_contacts
from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = ["Encoded", "LayerShard", "ShardRows", "TableIndex", "encode_table", "read_table"]

ARRAYS = "arrays.zarr"
THREADS_FROM = 2**24  # [bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardRows:
    """Where key frames lie: scene k of the shard's sim commit, frame f -> row k * frames + f."""

    scenes: tuple[int, ...]  # scene_index, in the order of the sim commit
    num_frames: int

    @property
    def count(self) -> int:
        """Rows of an array."""
        return len(self.scenes) * self.num_frames

    def start(self, scene_index: int) -> int:
        """Row of a scene's first key frame."""
        return self.scenes.index(scene_index) * self.num_frames


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoded:
    """What a layer writes into an attempt folder."""

    arrays: Mapping[str, ArraySpec | SpooledArray]
    tables: dict[str, pa.Table]


def encode_table(table: pa.Table, *, version: str = SCHEMA_VERSION) -> bytes:
    """A Parquet file: zstd, page checksums, `schema_version` in the footer."""
    table = table.replace_schema_metadata({"schema_version": version})
    buffer = BytesIO()
    pq.write_table(table, buffer, compression="zstd", write_page_checksum=True)
    return buffer.getvalue()


def read_table(store: Store, path: str) -> pa.Table:
    """Read Parquet, its page checksums verified.

    Raises:
        DamagedDatasetError: missing or damaged.
    """
    data = store.read(path)
    try:
        with pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True) as file:
            # Tables of a shard are small: starting threads costs more than it gains, and a command
            # that ends while Arrow still starts them is aborted.
            return file.read(use_threads=len(data) > THREADS_FROM)
    except (OSError, ValueError, pa.ArrowException) as error:  # damage shows in many ways
        raise DamagedDatasetError(f"{store.uri}: {path} cannot be read: {error}") from error


class TableIndex:
    """A table that is sorted by scene_index and frame_index, with fast look-up of a frame."""

    def __init__(self, table: pa.Table, *, num_frames: int) -> None:
        self.table = table
        self._frames = num_frames
        self._columns: dict[str, Any] = {}
        scene = table["scene_index"].to_numpy().astype(np.int64)
        self._keys = scene * num_frames
        if "frame_index" in table.column_names:  # the table of scenes has none
            self._keys = self._keys + table["frame_index"].to_numpy()

    def frame(self, scene_index: int, frame_index: int) -> pa.Table:
        """Rows of one frame, in stored order."""
        rows = self.frame_rows(scene_index, frame_index)
        return self.table.slice(rows.start, rows.stop - rows.start)

    def scene(self, scene_index: int) -> pa.Table:
        """Rows of one scene, in stored order."""
        rows = self.scene_rows(scene_index)
        return self.table.slice(rows.start, rows.stop - rows.start)

    def scene_rows(self, scene_index: int) -> slice:
        """Where the rows of one scene lie in a `column`."""
        return self._between(scene_index * self._frames, self._frames)

    def frame_rows(self, scene_index: int, frame_index: int) -> slice:
        """Where the rows of one frame lie in a `column`."""
        return self._between(scene_index * self._frames + frame_index, 1)

    def column(self, name: str) -> Any:
        """A whole column, converted once: numbers as an array, vectors as (rows, length), ragged
        lists and text as a list. Not to be written to.
        """
        if name not in self._columns:
            column = self.table[name].combine_chunks()
            if pa.types.is_fixed_size_list(column.type):
                values: Any = column.flatten().to_numpy().reshape(-1, column.type.list_size)
            elif pa.types.is_list(column.type) or pa.types.is_string(column.type):
                values = column.to_pylist()
            else:
                values = column.to_numpy(zero_copy_only=False)
            self._columns[name] = values
        return self._columns[name]

    def _between(self, key: int, length: int) -> slice:
        start = int(self._keys.searchsorted(key))
        return slice(start, int(self._keys.searchsorted(key + length)))


class LayerShard:
    """Reads one committed attempt; arrays and tables are opened when asked for."""

    def __init__(self, store: Store, commit: CommitRecord, rows: ShardRows) -> None:
        self._store, self.commit, self.rows = store, commit, rows
        self._arrays: dict[str, ShardedArray] = {}
        self._tables: dict[str, TableIndex] = {}

    @property
    def nbytes(self) -> int:
        """Memory [bytes] of the tables and small arrays that were read so far."""
        tables = sum(index.table.nbytes for index in self._tables.values())
        return tables + sum(array.nbytes for array in self._arrays.values())

    @property
    def array_names(self) -> list[str]:
        """Arrays that the commit names, sorted."""
        paths = (name.split("/") for name in self.commit.files)
        return sorted({path[1] for path in paths if path[0] == ARRAYS and len(path) > 2})

    @property
    def table_names(self) -> list[str]:
        """Tables that the commit names, sorted, without suffix."""
        files = (name for name in self.commit.files if name.endswith(".parquet"))
        return sorted(name.removesuffix(".parquet") for name in files)

    def array(self, name: str) -> ShardedArray:
        """An array of the layer."""
        if name not in self._arrays:
            path = f"{self.commit.path}/{ARRAYS}/{name}"
            self._arrays[name] = ShardedArray(path, store=self._store)
        return self._arrays[name]

    def table(self, name: str) -> TableIndex:
        """A table of the layer, by file name without suffix."""
        if name not in self._tables:
            table = read_table(self._store, f"{self.commit.path}/{name}.parquet")
            self._tables[name] = TableIndex(table, num_frames=self.rows.num_frames)
        return self._tables[name]

    def frames_with_contacts(self) -> TableIndex:
        """The table `frames`; of a commit of format 1.0 with the columns that were added since."""
        name = "frames with contacts"
        if name not in self._tables:
            table = with_contacts(self._store, self.commit, self.table("frames").table)
            self._tables[name] = TableIndex(table, num_frames=self.rows.num_frames)
        return self._tables[name]
