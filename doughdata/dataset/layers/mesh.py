"""Layer `mesh`: meshes of the components and the label grid, one row a key frame."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import UInt32

from doughdata.dataset.arrays import ArraySpec, padded_length
from doughdata.dataset.shards import Encoded, LayerShard, ShardRows
from doughschemas import (
    NO_COMPONENT,
    BadInputError,
    ComponentMesh,
    ComponentMeshes,
    LabelGrid,
)

__all__ = ["decode_label_grid", "decode_meshes", "encode_mesh"]

NO_VERTEX = 2**32 - 1  # padding of `faces`
Offsets = UInt32[np.ndarray, "components_plus_1"]


def encode_mesh(meshes: Mapping[int, Sequence[ComponentMeshes]], rows: ShardRows) -> Encoded:
    """Arrays of vertices, faces, their offsets per component, and label grids; no tables.

    Raises:
        BadInputError: a scene has another number of key frames than the dataset, or the label
            grids of a shard differ in spacing.
    """
    frames: dict[int, ComponentMeshes] = {}
    for index, entries in meshes.items():
        if len(entries) != rows.num_frames:
            raise BadInputError(
                f"scene {index}: meshes of {len(entries)} key frames, dataset has {rows.num_frames}"
            )
        start = rows.start(index)
        frames.update({start + k: entry for k, entry in enumerate(entries)})
    arrays = {**_geometry_arrays(frames, rows.count), **_grid_arrays(frames, rows.count)}
    return Encoded(arrays=arrays, tables={})


def decode_meshes(
    shard: LayerShard, scene_index: int, frame_index: int
) -> tuple[ComponentMesh, ...]:
    """Meshes of one key frame, in the order of the labels."""
    row = shard.rows.start(scene_index) + frame_index
    count = int(shard.array("num_meshes").row(row))
    first_vertex = shard.array("vertex_offsets").row(row)
    first_face = shard.array("face_offsets").row(row)
    vertices = shard.array("vertices").row(row)
    faces = shard.array("faces").row(row)
    return tuple(
        ComponentMesh(
            vertices=vertices[first_vertex[k] : first_vertex[k + 1]],
            faces=faces[first_face[k] : first_face[k + 1]],
        )
        for k in range(count)
    )


def decode_label_grid(shard: LayerShard, scene_index: int, frame_index: int) -> LabelGrid:
    """Label grid of one key frame."""
    row = shard.rows.start(scene_index) + frame_index
    grid = shard.array("label_grid")
    nx, ny, nz = (int(n) for n in shard.array("label_grid_shape").row(row))
    return LabelGrid(
        labels=grid.row(row)[:nx, :ny, :nz],
        origin=shard.array("label_grid_origin").row(row).copy(),
        spacing=float(grid.attributes["spacing"]),
    )


def _geometry_arrays(frames: Mapping[int, ComponentMeshes], count: int) -> dict[str, ArraySpec]:
    most = max((len(f.meshes) for f in frames.values()), default=0)
    vertex_offsets = np.zeros((count, most + 1), np.uint32)
    face_offsets = np.zeros((count, most + 1), np.uint32)
    num_meshes = np.zeros(count, np.uint8)
    for row, frame in frames.items():
        num_meshes[row] = len(frame.meshes)
        vertex_offsets[row] = _offsets([len(m.vertices) for m in frame.meshes], most)
        face_offsets[row] = _offsets([len(m.faces) for m in frame.meshes], most)
    vertices = np.full((count, padded_length(int(vertex_offsets.max())), 3), np.nan, np.float32)
    faces = np.full((count, padded_length(int(face_offsets.max())), 3), NO_VERTEX, np.uint32)
    for row, frame in frames.items():
        for k, mesh in enumerate(frame.meshes):
            vertices[row, vertex_offsets[row, k] : vertex_offsets[row, k + 1]] = mesh.vertices
            faces[row, face_offsets[row, k] : face_offsets[row, k + 1]] = mesh.faces
    offset_axes = ("row", "component")
    return {
        "vertices": ArraySpec(data=vertices, axes=("row", "vertex", "xyz"), fill=np.nan),
        "faces": ArraySpec(data=faces, axes=("row", "face", "corner"), fill=NO_VERTEX),
        "vertex_offsets": ArraySpec(data=vertex_offsets, axes=offset_axes, fill=0, by_row=False),
        "face_offsets": ArraySpec(data=face_offsets, axes=offset_axes, fill=0, by_row=False),
        "num_meshes": ArraySpec(data=num_meshes, axes=("row",), fill=0, by_row=False),
    }


def _grid_arrays(frames: Mapping[int, ComponentMeshes], count: int) -> dict[str, ArraySpec]:
    grids = {row: frame.label_grid for row, frame in frames.items()}
    spacings = {grid.spacing for grid in grids.values()}
    if len(spacings) != 1:
        raise BadInputError(f"label grids must share one spacing, got {sorted(spacings)} m")
    shape = np.max([grid.labels.shape for grid in grids.values()], axis=0)
    shape = (int(shape[0]), int(shape[1]), padded_length(int(shape[2])))
    labels = np.full((count, *shape), NO_COMPONENT, np.uint8)
    shapes = np.zeros((count, 3), np.uint32)
    origins = np.zeros((count, 3), np.float64)
    for row, grid in grids.items():
        nx, ny, nz = grid.labels.shape
        labels[row, :nx, :ny, :nz] = grid.labels
        shapes[row], origins[row] = grid.labels.shape, grid.origin
    axes = ("row", "x", "y", "z")
    attributes = {"spacing": float(spacings.pop())}  # [m]
    spec = ArraySpec(data=labels, axes=axes, fill=NO_COMPONENT, attributes=attributes)
    beside = ("row", "xyz")
    return {
        "label_grid": spec,
        "label_grid_origin": ArraySpec(data=origins, axes=beside, fill=0.0, by_row=False),
        "label_grid_shape": ArraySpec(data=shapes, axes=beside, fill=0, by_row=False),
    }


def _offsets(lengths: Sequence[int], most: int) -> Offsets:
    """Starts of the components, then the total; missing components repeat the total."""
    ends = np.cumsum([0, *lengths])
    return np.pad(ends, (0, most - len(lengths)), mode="edge").astype(np.uint32)
