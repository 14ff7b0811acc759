"""Which views a loader serves, and one key frame of it as tensors."""

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from doughdata.dataset import Dataset, Frame
from doughdata.seeds import seed_sequence
from doughdata.torch.recorded import recorded_arrays
from doughdata.torch.sampling import (
    NO_POINT,
    complete_points,
    dough_points,
    grid_labels,
    query_points,
    tool_points,
)
from doughschemas import NO_COMPONENT, BadInputError, MissingLayerError

__all__ = ["COMPLETE", "SampleSize", "choose_views", "frame_sample"]

RECORDED_SENSOR = "recorded"  # depth of a real camera
COMPLETE = "complete"  # no camera: points all over the true surfaces
Rows = Int64[np.ndarray, " views"]
COLUMNS = ("scene_index", "frame_index", "view_index")


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSize:
    """How much of a key frame a sample holds."""

    num_points: int = 1024  # drawn again if the view has fewer
    num_queries: int = 2048
    num_tool_points: int = 128  # a finger
    max_components: int = 8  # length of `genus`


def choose_views(
    source: Dataset, sensor: str, *, split: str | None, frames: Collection[int] | None
) -> Int64[np.ndarray, "views 3"]:
    """(scene_index, frame_index, view_index) of every wanted view, in the table's order.

    Raises:
        MissingLayerError: the dataset has no such depth layer; names the command that makes it.
        BadInputError: nothing is left after the choice of split and frames.
    """
    if sensor == COMPLETE:
        scene, frame, view = _meshed(source)
        return _kept(source, scene, frame, view, split=split, frames=frames)
    views = source.table("views")
    layer = np.asarray(views["layer"].to_pylist(), dtype=object)
    keep = layer == f"depth.{sensor}"
    if not keep.any():
        raise MissingLayerError(
            f"{source.uri} has no layer 'depth.{sensor}'; make it with "
            f"`doughdata render --noise {sensor} --dataset {source.uri}`"
        )
    scene, frame, view = (views[name].to_numpy().astype(np.int64)[keep] for name in COLUMNS)
    return _kept(source, scene, frame, view, split=split, frames=frames)


def _meshed(source: Dataset) -> tuple[Rows, Rows, Rows]:
    """Every key frame of every scene that has meshes, its surface being view 0."""
    scenes = [k for k in source.scene_indices if _has_meshes(source, k)]
    if not scenes:
        raise MissingLayerError(f"{source.uri} has no layer 'mesh'; make it with `doughdata mesh`")
    scene = np.repeat(np.array(scenes, np.int64), source.num_frames)
    frame = np.tile(np.arange(source.num_frames), len(scenes))
    return scene, frame, np.zeros_like(scene)


def _has_meshes(source: Dataset, scene: int) -> bool:
    try:
        source.layer("mesh", scene)
    except MissingLayerError:
        return False
    return True


def _kept(
    source: Dataset,
    scene: Rows,
    frame: Rows,
    view: Rows,
    *,
    split: str | None,
    frames: Collection[int] | None,
) -> Int64[np.ndarray, "kept 3"]:
    scenes, keep = source.scenes, np.ones(len(scene), bool)
    if split is not None:
        of_split = [value == split for value in scenes["split"].to_pylist()]
        keep &= np.isin(scene, scenes["scene_index"].to_numpy()[np.array(of_split, bool)])
    if frames is not None:
        keep &= np.isin(frame, list(frames))
    if not keep.any():
        raise BadInputError(f"{source.uri}: no view is left (split={split!r}, {frames=})")
    return np.stack([scene[keep], frame[keep], view[keep]], axis=1)


def frame_sample(
    frame: Frame, sensor: str, view: int, size: SampleSize, *, seed: int, epoch: int
) -> dict[str, Tensor]:
    """One view of a key frame with its queries, tool points and topology.

    Raises:
        BadInputError: more components than `size` has room for.
    """
    scene_index, frame_index = frame.scene_index, frame.frame_index
    key = ("loader", epoch, scene_index, frame_index, view)
    rng = np.random.default_rng(seed_sequence(seed, *key))
    if sensor == RECORDED_SENSOR:
        arrays, count = recorded_arrays(frame, sensor, view, rng, **asdict(size))
        return _tensors(arrays, frame, view, num_components=count)
    genus = frame.genus
    if len(genus) > size.max_components:
        raise BadInputError(
            f"{frame} has {len(genus)} components; raise max_components={size.max_components}"
        )
    if sensor == COMPLETE:
        points, point_labels = complete_points(frame.meshes, size.num_points, rng)
    else:
        points, point_labels = dough_points(frame.depth(sensor), view, size.num_points, rng)
    queries = query_points(frame.meshes, size.num_queries, rng)
    labels = grid_labels(frame.label_grid, queries)
    padded = np.full(size.max_components, NO_POINT, np.int64)
    padded[: len(genus)] = genus
    arrays = {
        "points": points,
        "point_labels": point_labels,
        "queries": queries,
        "query_labels": np.where(labels == NO_COMPONENT, len(genus), labels),
        "tool_points": tool_points(frame.tools, size.num_tool_points, rng),
        "genus": padded,
    }
    return _tensors(arrays, frame, view, num_components=len(genus))


def _tensors(
    arrays: Mapping[str, np.ndarray], frame: Frame, view: int, *, num_components: int
) -> dict[str, Tensor]:
    scalars: Mapping[str, int] = {
        "num_components": num_components,
        "scene_index": frame.scene_index,
        "frame_index": frame.frame_index,
        "view_index": view,
    }
    tensors = {name: _tensor(value) for name, value in arrays.items()}
    return tensors | {name: torch.tensor(value) for name, value in scalars.items()}


def _tensor(values: np.ndarray) -> Tensor:
    kind = np.float32 if np.issubdtype(values.dtype, np.floating) else np.int64
    return torch.from_numpy(np.ascontiguousarray(values, kind))
