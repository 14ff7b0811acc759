"""One committed layer of one shard: its rows, arrays and tables."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset.arrays import ArraySpec, ShardedArray
from doughdata.dataset.commits import CommitRecord
from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = ["Encoded", "LayerShard", "ShardRows", "TableIndex", "read_table", "write_table"]

ARRAYS = "arrays.zarr"


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

    arrays: dict[str, ArraySpec]
    tables: dict[str, pa.Table]


def write_table(path: Path, table: pa.Table) -> None:
    """Write Parquet: zstd, page checksums, `schema_version` in the footer."""
    table = table.replace_schema_metadata({"schema_version": SCHEMA_VERSION})
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def read_table(path: Path) -> pa.Table:
    """Read Parquet, its page checksums verified.

    Raises:
        DamagedDatasetError: missing or damaged.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            return file.read()
    except (OSError, ValueError, pa.ArrowException) as error:  # damage shows in many ways
        raise DamagedDatasetError(f"{path} cannot be read: {error}") from error


class TableIndex:
    """A table that is sorted by scene_index and frame_index, with fast look-up of a frame."""

    def __init__(self, table: pa.Table, *, num_frames: int) -> None:
        self.table = table
        self._frames = num_frames
        scene = table["scene_index"].to_numpy().astype(np.int64)
        self._keys = scene * num_frames
        if "frame_index" in table.column_names:  # the table of scenes has none
            self._keys = self._keys + table["frame_index"].to_numpy()

    def frame(self, scene_index: int, frame_index: int) -> pa.Table:
        """Rows of one frame, in stored order."""
        return self._between(scene_index * self._frames + frame_index, 1)

    def scene(self, scene_index: int) -> pa.Table:
        """Rows of one scene, in stored order."""
        return self._between(scene_index * self._frames, self._frames)

    def _between(self, key: int, length: int) -> pa.Table:
        start, stop = np.searchsorted(self._keys, [key, key + length])
        return self.table.slice(start, stop - start)


class LayerShard:
    """Reads one committed attempt; arrays and tables are opened when asked for."""

    def __init__(self, root: Path, commit: CommitRecord, rows: ShardRows) -> None:
        self.root, self.commit, self.rows = root, commit, rows
        self._arrays: dict[str, ShardedArray] = {}
        self._tables: dict[str, TableIndex] = {}

    @cached_property
    def folder(self) -> Path:
        """The attempt folder."""
        return self.root / (self.commit.path or "")

    def array(self, name: str) -> ShardedArray:
        """An array of the layer."""
        if name not in self._arrays:
            self._arrays[name] = ShardedArray(self.folder / ARRAYS / name)
        return self._arrays[name]

    def table(self, name: str) -> TableIndex:
        """A table of the layer, by file name without suffix."""
        if name not in self._tables:
            table = read_table(self.folder / f"{name}.parquet")
            self._tables[name] = TableIndex(table, num_frames=self.rows.num_frames)
        return self._tables[name]
