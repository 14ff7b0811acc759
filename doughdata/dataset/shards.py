"""One committed layer of one shard: its rows, arrays and tables."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from itertools import pairwise
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
SMALL = 2**17  # [bytes] of a table in memory
ITEM = 100  # [bytes], of a list of a few numbers or a short text


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


def encode_table(table: pa.Table, *, version: str = SCHEMA_VERSION, parts: bool = False) -> bytes:
    """A Parquet file with page checksums and `schema_version` in the footer.

    Small ones are compressed with snappy, because opening a zstd stream for every column takes
    longer than all the rest. `parts`: a large table of a shard, sorted by scene, gets row groups of
    whole scenes, so that one key frame costs one of them.
    """
    table = table.replace_schema_metadata({"schema_version": version})
    buffer, small = BytesIO(), table.nbytes < SMALL
    codec = "snappy" if small else "zstd"
    options: Any = {"compression": codec, "write_page_checksum": True}
    if small or not parts or "scene_index" not in table.column_names:
        pq.write_table(table, buffer, **options)
        return buffer.getvalue()
    with pq.ParquetWriter(buffer, table.schema, **options) as writer:
        for start, stop in pairwise(_part_ends(table)):
            writer.write_table(
                table.slice(start, stop - start), row_group_size=max(1, stop - start)
            )
    return buffer.getvalue()


def _part_ends(table: pa.Table) -> list[int]:
    """Rows at which the row groups of a large table begin: at a scene, SMALL bytes apart."""
    scene = table["scene_index"].to_numpy()
    rows = max(1, SMALL * len(table) // max(table.nbytes, 1))
    ends = [0]
    for start in (np.flatnonzero(np.diff(scene)) + 1).tolist():
        if start - ends[-1] >= rows:
            ends.append(start)
    return [*ends, len(table)] if ends[-1] < len(table) else [0, len(table)]


def read_table(store: Store, path: str) -> pa.Table:
    """Read Parquet, its page checksums verified.

    Raises:
        DamagedDatasetError: missing or damaged.
    """
    return TableFile(store, path).read()


class TableFile:
    """A Parquet file in memory, whose columns are decoded when they are asked for."""

    def __init__(self, store: Store, path: str) -> None:
        self._name = f"{store.uri}: {path}"
        data = store.read(path)
        self.nbytes = len(data)
        with self._explained():
            source = pa.BufferReader(data)
            self._file = pq.ParquetFile(source, page_checksum_verification=True)
            meta = self._file.metadata
            lengths = [meta.row_group(k).num_rows for k in range(meta.num_row_groups)]
        self.ends = np.cumsum([0, *lengths])  # rows at which the row groups begin, then the total

    @property
    def names(self) -> list[str]:
        """Columns."""
        return self._file.schema_arrow.names

    def read(self, columns: list[str] | None = None, group: int | None = None) -> pa.Table:
        """Some or all columns, of one row group or of all. Raises DamagedDatasetError."""
        # Tables of a shard are small: starting threads costs more than it gains, and a command
        # that ends while Arrow still starts them is aborted.
        threads = self.nbytes > THREADS_FROM
        with self._explained():
            if group is None:
                return self._file.read(columns=columns, use_threads=threads)
            return self._file.read_row_group(group, columns=columns, use_threads=threads)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, pa.ArrowException) as error:  # damage shows in many ways
            raise DamagedDatasetError(f"{self._name} cannot be read: {error}") from error


class TableIndex:
    """A table that is sorted by scene_index and frame_index, with fast look-up of a frame.

    Of a file only those columns and row groups are decoded that are asked for.
    """

    def __init__(self, source: TableFile | pa.Table, *, num_frames: int) -> None:
        self._source, self._frames = source, num_frames
        self._parts: dict[tuple[str, int], Any] = {}
        self._loaded: set[tuple[tuple[str, ...], int]] = set()
        if isinstance(source, TableFile):
            self._ends, names = source.ends, source.names
        else:
            self._ends, names = np.array([0, len(source)]), source.column_names
        # The table of scenes has no frame_index.
        wanted = [name for name in ("scene_index", "frame_index") if name in names]
        keys = source.read(wanted) if isinstance(source, TableFile) else source.select(wanted)
        self._keys = keys["scene_index"].to_numpy().astype(np.int64) * num_frames
        if len(wanted) > 1:
            self._keys = self._keys + keys["frame_index"].to_numpy()

    @cached_property
    def table(self) -> pa.Table:
        """The whole table."""
        return self._source.read() if isinstance(self._source, TableFile) else self._source

    @property
    def nbytes(self) -> int:
        """Memory [bytes] of the file or table, and of what was decoded; lists are a guess."""
        whole = self.__dict__.get("table")
        decoded = sum(getattr(part, "nbytes", ITEM * len(part)) for part in self._parts.values())
        own = self._source.nbytes + self._keys.nbytes + decoded
        return own + (0 if whole is None else whole.nbytes)

    def frame(self, scene_index: int, frame_index: int) -> pa.Table:
        """Rows of one frame, in stored order."""
        rows = self.frame_rows(scene_index, frame_index)
        return self.table.slice(rows.start, rows.stop - rows.start)

    def scene(self, scene_index: int) -> pa.Table:
        """Rows of one scene, in stored order."""
        rows = self.scene_rows(scene_index)
        return self.table.slice(rows.start, rows.stop - rows.start)

    def scene_rows(self, scene_index: int) -> slice:
        """Where the rows of one scene lie; see `values`."""
        return self._between(scene_index * self._frames, self._frames)

    def frame_rows(self, scene_index: int, frame_index: int) -> slice:
        """Where the rows of one frame lie; see `values`."""
        return self._between(scene_index * self._frames + frame_index, 1)

    def values(self, name: str, rows: slice) -> Any:
        """Some rows of a column: numbers as an array, vectors as (rows, length), ragged lists and
        text as a list. Not to be written to.
        """
        ends = self._ends
        if len(ends) == 2:  # the usual case: one row group
            return self._part(name, 0)[rows]
        first = min(int(ends.searchsorted(rows.start, "right")), len(ends) - 1) - 1
        start = int(ends[first])
        if rows.stop <= ends[first + 1]:
            return self._part(name, first)[rows.start - start : rows.stop - start]
        last = int(ends.searchsorted(rows.stop, "left"))
        parts = [self._part(name, group) for group in range(first, last)]
        if isinstance(parts[0], list):
            whole = [value for part in parts for value in part]
        else:
            whole = np.concatenate(parts)
        return whole[rows.start - start : rows.stop - start]

    def load(self, names: tuple[str, ...], rows: slice) -> None:
        """Decode several columns of the row group of some rows at once; `values` has them then."""
        group = 0
        if len(self._ends) > 2:
            group = min(int(self._ends.searchsorted(rows.start, "right")), len(self._ends) - 1) - 1
        if (names, group) in self._loaded:
            return
        self._loaded.add((names, group))
        missing = [name for name in names if (name, group) not in self._parts]
        if missing and isinstance(self._source, TableFile):
            table = self._source.read(missing, group)
            for name in missing:
                self._parts[name, group] = _converted(table[name].combine_chunks())

    def value(self, name: str, row: int) -> Any:
        """One row of a column."""
        return self.values(name, slice(row, row + 1))[0]

    def _part(self, name: str, group: int) -> Any:
        """A column in one row group, converted once."""
        found = self._parts.get((name, group))
        if found is None:
            source = self._source
            table = source.read([name], group) if isinstance(source, TableFile) else source
            found = self._parts[name, group] = _converted(table[name].combine_chunks())
        return found

    def _between(self, key: int, length: int) -> slice:
        start = int(self._keys.searchsorted(key))
        return slice(start, int(self._keys.searchsorted(key + length)))


def _converted(column: Any) -> Any:
    if pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy().reshape(-1, column.type.list_size)
    if pa.types.is_list(column.type) or pa.types.is_string(column.type):
        return column.to_pylist()
    return column.to_numpy(zero_copy_only=False)


class LayerShard:
    """Reads one committed attempt; arrays and tables are opened when asked for."""

    def __init__(self, store: Store, commit: CommitRecord, rows: ShardRows) -> None:
        self._store, self.commit, self.rows = store, commit, rows
        self._arrays: dict[str, ShardedArray] = {}
        self._tables: dict[str, TableIndex] = {}

    @property
    def nbytes(self) -> int:
        """Memory [bytes] of the tables and small arrays that were read so far."""
        tables = sum(index.nbytes for index in self._tables.values())
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
            file = TableFile(self._store, f"{self.commit.path}/{name}.parquet")
            self._tables[name] = TableIndex(file, num_frames=self.rows.num_frames)
        return self._tables[name]

    def frames_with_contacts(self) -> TableIndex:
        """The table `frames`; of a commit of format 1.0 with the columns that were added since."""
        name = "frames with contacts"
        if name not in self._tables:
            table = with_contacts(self._store, self.commit, self.table("frames").table)
            self._tables[name] = TableIndex(table, num_frames=self.rows.num_frames)
        return self._tables[name]
