"""Numpy arrays as Arrow columns and back."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

__all__ = ["frame_columns", "int_lists", "vectors", "vectors_array"]


def frame_columns(frames: Mapping[int, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns scene_index (i64) and frame_index (i32) of rows that are given per scene."""
    scenes = [np.full(len(f), index, np.int64) for index, f in frames.items()]
    return {
        "scene_index": np.concatenate(scenes) if scenes else np.zeros(0, np.int64),
        "frame_index": np.concatenate([np.zeros(0, np.int32), *frames.values()]).astype(np.int32),
    }


def vectors(values: np.ndarray, dtype: Any) -> pa.FixedSizeListArray:
    """(n, k) values as a column of lists of length k."""
    flat = pa.array(np.ascontiguousarray(values, dtype).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def vectors_array(column: pa.ChunkedArray, size: int, dtype: Any) -> np.ndarray:
    """The (n, size) values of such a column."""
    parts = [chunk.flatten().to_numpy(zero_copy_only=False) for chunk in column.chunks]
    flat = np.concatenate(parts) if parts else np.zeros(0)
    return flat.astype(dtype).reshape(-1, size)


def int_lists(values: Sequence[Sequence[int]]) -> pa.Array:
    """Ragged lists of integers."""
    return pa.array([list(map(int, value)) for value in values], pa.list_(pa.int32()))
