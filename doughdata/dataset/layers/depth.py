"""Layer `depth.<sensor>`: depth images and segments, one row a view; cameras as a table."""

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from doughdata.dataset.arrays import ArraySpec
from doughdata.dataset.layers.columns import frame_columns, vectors
from doughdata.dataset.shards import Encoded, LayerShard, ShardRows, TableIndex
from doughschemas import BadInputError, Camera, DepthViews, Intrinsics

__all__ = ["decode_depth", "encode_depth"]

INTRINSICS = {"width": np.int32, "height": np.int32} | dict.fromkeys(
    ("fx", "fy", "cx", "cy"), np.float64
)

CAMERA_COLUMNS = ("row", "frame_index", "view_index", "position", "quaternion", *INTRINSICS)


def encode_depth(views: Mapping[int, DepthViews], rows: ShardRows) -> Encoded:
    """Arrays `depth` and `segments`; table views. A view's row is its place in that table.

    Raises:
        BadInputError: no view at all, or views of a shard differ in size or depth unit.
    """
    views = {index: _sorted(views[index]) for index in rows.scenes if index in views}
    sizes = {record.depth.shape[1:] for record in views.values()}
    units = {record.depth_unit for record in views.values()}
    if len(sizes) != 1 or len(units) != 1:
        raise BadInputError(
            f"views of a layer must share one size and unit, got {sorted(sizes)} px "
            f"and {sorted(units)} m"
        )
    depth = np.concatenate([record.depth for record in views.values()])
    segments = np.concatenate([record.segments for record in views.values()])
    if len(depth) == 0:
        raise BadInputError("a depth layer needs at least one view")
    axes, attributes = ("view", "y", "x"), {"depth_unit": units.pop()}  # [m]
    arrays = {
        "depth": ArraySpec(data=depth, axes=axes, fill=0, attributes=attributes),
        "segments": ArraySpec(data=segments, axes=axes, fill=0),
    }
    return Encoded(arrays=arrays, tables={"views": _views_table(views)})


def decode_depth(shard: LayerShard, scene_index: int, frame_index: int | None = None) -> DepthViews:
    """Views of a scene or of one of its key frames; there may be none."""
    index, depth = shard.table("views"), shard.array("depth")
    if frame_index is None:
        here = index.scene_rows(scene_index)
    else:
        here = index.frame_rows(scene_index, frame_index)
    count = here.stop - here.start
    index.load(CAMERA_COLUMNS, here)
    start = int(index.value("row", here.start)) if count else 0
    return DepthViews(
        depth=depth.rows(start, start + count),
        segments=shard.array("segments").rows(start, start + count),
        frame_index=index.values("frame_index", here).copy(),
        view_index=index.values("view_index", here).copy(),
        cameras=_cameras(index, here),
        depth_unit=float(depth.attributes["depth_unit"]),
    )


def _sorted(views: DepthViews) -> DepthViews:
    """The same views by frame, then view: rows of one frame lie together."""
    order = np.lexsort((views.view_index, views.frame_index))
    return DepthViews(
        depth=views.depth[order],
        segments=views.segments[order],
        frame_index=views.frame_index[order],
        view_index=views.view_index[order],
        cameras=tuple(views.cameras[k] for k in order),
        depth_unit=views.depth_unit,
    )


def _views_table(views: Mapping[int, DepthViews]) -> pa.Table:
    cameras = [camera for record in views.values() for camera in record.cameras]
    frames = frame_columns({index: record.frame_index for index, record in views.items()})
    return pa.table(
        {
            **frames,
            "view_index": np.concatenate([r.view_index for r in views.values()]).astype(np.int32),
            "row": np.arange(len(cameras), dtype=np.int64),
            "position": _vectors([camera.position for camera in cameras]),
            "quaternion": _vectors([camera.quaternion for camera in cameras]),
            **{
                name: np.array([getattr(c.intrinsics, name) for c in cameras], dtype)
                for name, dtype in INTRINSICS.items()
            },
        }
    )


def _vectors(values: Sequence[Sequence[float]]) -> pa.FixedSizeListArray:
    return vectors(np.array(values, np.float64), np.float64)


def _cameras(views: TableIndex, rows: slice) -> tuple[Camera, ...]:
    position, quaternion, *intrinsics = (
        views.values(name, rows).tolist() for name in ("position", "quaternion", *INTRINSICS)
    )
    return tuple(
        Camera(
            intrinsics=Intrinsics(**dict(zip(INTRINSICS, numbers, strict=True))),
            position=tuple(at),
            quaternion=tuple(turned),
        )
        for at, turned, *numbers in zip(position, quaternion, *intrinsics, strict=True)
    )
