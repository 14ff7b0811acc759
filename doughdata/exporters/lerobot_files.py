"""Files of a LeRobot dataset: data of whole episodes, Arrow types, the table of tasks."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset.statistics import Moments

__all__ = [
    "CHUNK",
    "DATA_PATH",
    "FILE_BYTES",
    "DataFiles",
    "Episode",
    "arrow_type",
    "feature",
    "split_ranges",
    "task_table",
]

CHUNK = 1000  # files a folder
FILE_BYTES = 100 * 2**20
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


@dataclass(slots=True)
class Episode:
    """Frames of one scene, column by column."""

    columns: dict[str, list[Any]] = field(default_factory=dict)
    stats: dict[str, Moments] = field(default_factory=dict)

    def add(self, name: str, value: Any, numbers: np.ndarray) -> None:
        """Append a value; `numbers` (n, components) are what its statistics count."""
        self.columns.setdefault(name, []).append(value)
        self.stats.setdefault(name, Moments()).add(numbers)

    @property
    def length(self) -> int:
        """Number of frames."""
        return len(self.columns["timestamp"])


class DataFiles:
    """Data files of whole episodes, each closed when it is large enough."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number, self._writer = folder, 0, None

    def __enter__(self) -> "DataFiles":
        return self

    def __exit__(self, *error: object) -> None:
        if self._writer is not None:
            self._writer.close()

    @property
    def place(self) -> tuple[int, int]:
        """Chunk and file of the next episode."""
        return divmod(self._number, CHUNK)

    def write(self, episode: Episode, schema: pa.Schema) -> None:
        """Append an episode."""
        chunk, number = self.place
        path = self._folder / DATA_PATH.format(chunk_index=chunk, file_index=number)
        if self._writer is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, schema, compression="snappy")
        columns = {name: episode.columns[name] for name in schema.names}
        self._writer.write_table(pa.Table.from_pydict(columns, schema=schema))
        if path.stat().st_size >= FILE_BYTES:
            self._writer.close()
            self._writer, self._number = None, self._number + 1


def feature(dtype: str, shape: Sequence[int], names: Any) -> dict[str, Any]:
    """An entry of `features` in `meta/info.json`."""
    return {"dtype": dtype, "shape": list(shape), "names": names}


def arrow_type(dtype: str, shape: Sequence[int]) -> pa.DataType:
    """Type of a feature's column."""
    if dtype == "image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    kind = {"bool": pa.bool_(), "float32": pa.float32(), "int64": pa.int64()}.get(dtype)
    kind = getattr(pa, dtype)() if kind is None else kind
    if len(shape) == 2:
        return pa.list_(pa.list_(kind))
    return kind if tuple(shape) == (1,) else pa.list_(kind, shape[0])


def split_ranges(splits: Sequence[str]) -> dict[str, str]:
    """Split -> `first:last+1` of its episodes, which lie together."""
    return {
        split: f"{splits.index(split)}:{splits.index(split) + splits.count(split)}"
        for split in dict.fromkeys(splits)
    }


def task_table(tasks: Mapping[str, int]) -> pa.Table:
    """The table that pandas reads back with the task's text as its index."""
    table = pa.table({"task_index": list(tasks.values()), "__index_level_0__": list(tasks)})
    columns = [
        {"name": None, "field_name": "__index_level_0__", "pandas_type": "unicode"},
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64"},
    ]
    types = {"unicode": "object", "int64": "int64"}
    columns = [{**c, "numpy_type": types[str(c["pandas_type"])], "metadata": None} for c in columns]
    pandas = {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [],
        "columns": columns[::-1],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
