"""The dataset as a PyTorch map-style dataset: one sample a depth view.

Picklable, safe with `fork`, `spawn` and `forkserver` workers. A sample depends on seed, epoch,
scene, frame and view alone, never on the number of workers.
"""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor
from torch.utils.data import Dataset

from doughdata.dataset import FrameTools, open_dataset
from doughdata.geometry import points_from_depth, transform_points
from doughdata.registry import require_package
from doughdata.seeds import seed_sequence
from doughschemas import (
    NO_COMPONENT,
    SEGMENT_COMPONENT,
    BadInputError,
    ComponentMesh,
    DepthViews,
    LabelGrid,
    MissingLayerError,
    Tool,
)

__all__ = ["DoughDataset"]

# Box [m] of the uniform queries: the square that bodies stay in, and above it what dough reaches.
WORKSPACE = np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.06]])
NEAR_SURFACE = 0.004  # [m], standard deviation of the other queries about the surface
NO_POINT = -1  # label of padding


class DoughDataset(Dataset[dict[str, Tensor]]):
    """Samples for shape and topology learning, one per depth view.

    A sample holds, as float32 in [m], world frame:

    - `points` (num_points, 3): back-projected dough pixels;
    - `queries` (num_queries, 3): half uniform in the workspace, half about the surface;
    - `tool_points` (2, num_tool_points, 3): on the surfaces of both fingers;

    and as int64:

    - `point_labels` (num_points,): component of each point;
    - `query_labels` (num_queries,): component at the nearest node of the label grid, or
      `num_components` for empty space;
    - `genus` (max_components,), padded with -1;
    - `num_components`, `scene_index`, `frame_index`, `view_index`: scalars.

    A view in which no dough is seen has zeros as points and -1 as their labels.

    Args:
        uri: the dataset.
        sensor: which depth layer, e.g. "realsense".
        split: "train" or "test"; None takes both.
        frames: key frames to use; None takes every one that has a view.
        num_points: points a sample; drawn again if the view has fewer.
        num_queries: queries a sample.
        num_tool_points: points a finger.
        max_components: length of `genus`.
        seed: root of all random choices.

    Raises:
        MissingLayerError: the dataset has no such depth layer; names the command that makes it.
        BadInputError: nothing is left after the choice of split and frames.
    """

    def __init__(
        self,
        uri: str | Path,
        *,
        sensor: str = "realsense",
        split: str | None = None,
        frames: Collection[int] | None = None,
        num_points: int = 1024,
        num_queries: int = 2048,
        num_tool_points: int = 128,
        max_components: int = 8,
        seed: int = 0,
    ) -> None:
        self.source = open_dataset(uri)
        self.sensor, self.seed = sensor, seed
        self.num_points, self.num_queries = num_points, num_queries
        self.num_tool_points, self.max_components = num_tool_points, max_components
        self._views = self._choose(split, frames)
        # In shared memory, so that `set_epoch` reaches workers that are already running.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        """Number of views."""
        return len(self._views)

    def set_epoch(self, epoch: int) -> None:
        """Draw other points and queries from now on; the same epoch gives the same again."""
        self._epoch.fill_(epoch)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """One sample.

        Raises:
            IndexError: no such view.
            DamagedDatasetError: a byte on disk has changed.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"view {index} of {len(self)}")
        scene, frame_index, view = (int(value) for value in self._views[index])
        key = ("loader", int(self._epoch), scene, frame_index, view)
        rng = np.random.default_rng(seed_sequence(self.seed, *key))
        frame = self.source.frame(scene=scene, frame=frame_index)
        genus = frame.topology.genus
        if len(genus) > self.max_components:
            raise BadInputError(
                f"{frame} has {len(genus)} components; raise max_components={self.max_components}"
            )
        points, point_labels = _dough_points(frame.depth(self.sensor), view, self.num_points, rng)
        queries = _queries(frame.meshes, self.num_queries, rng)
        labels = _grid_labels(frame.label_grid, queries)
        padded = np.full(self.max_components, NO_POINT, np.int64)
        padded[: len(genus)] = genus
        sample: dict[str, Any] = {
            "points": points,
            "point_labels": point_labels,
            "queries": queries,
            "query_labels": np.where(labels == NO_COMPONENT, len(genus), labels),
            "tool_points": _tool_points(frame.tools, self.num_tool_points, rng),
            "genus": padded,
        }
        scalars = {
            "num_components": len(genus),
            "scene_index": scene,
            "frame_index": frame_index,
            "view_index": view,
        }
        tensors = {name: _tensor(value) for name, value in sample.items()}
        return tensors | {name: torch.tensor(value) for name, value in scalars.items()}

    def _choose(
        self, split: str | None, frames: Collection[int] | None
    ) -> Int64[np.ndarray, "views 3"]:
        """(scene_index, frame_index, view_index) of every sample."""
        views, scenes = self.source.table("views"), self.source.scenes
        layer = np.asarray(views["layer"].to_pylist(), dtype=object)
        keep = layer == f"depth.{self.sensor}"
        if not keep.any():
            raise MissingLayerError(
                f"{self.source.uri} has no layer 'depth.{self.sensor}'; make it with "
                f"`doughdata render --noise {self.sensor} --dataset {self.source.uri}`"
            )
        names = ("scene_index", "frame_index", "view_index")
        scene, frame, view = (views[name].to_numpy().astype(np.int64) for name in names)
        if split is not None:
            of_split = [value == split for value in scenes["split"].to_pylist()]
            keep &= np.isin(scene, scenes["scene_index"].to_numpy()[np.array(of_split, bool)])
        if frames is not None:
            keep &= np.isin(frame, list(frames))
        if not keep.any():
            raise BadInputError(f"{self.source.uri}: no view is left (split={split!r}, {frames=})")
        return np.stack([scene[keep], frame[keep], view[keep]], axis=1)


def _tensor(values: np.ndarray) -> Tensor:
    kind = np.float32 if np.issubdtype(values.dtype, np.floating) else np.int64
    return torch.from_numpy(np.ascontiguousarray(values, kind))


def _dough_points(
    views: DepthViews, view: int, count: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    """`count` random dough pixels as points [m], and their components."""
    row = int(np.flatnonzero(views.view_index == view)[0])
    depth, segments = views.depth[row], views.segments[row]
    pixels = np.flatnonzero((segments >= SEGMENT_COMPONENT) & (depth > 0))
    if len(pixels) == 0:
        return np.zeros((count, 3)), np.full(count, NO_POINT, np.int64)
    chosen = np.sort(rng.choice(pixels, min(count, len(pixels)), replace=False))
    mask = np.zeros(depth.shape, bool)
    mask.flat[chosen] = True
    points = points_from_depth(depth * views.depth_unit, views.cameras[row], mask)
    labels = segments.flat[chosen].astype(np.int64) - SEGMENT_COMPONENT
    order = rng.permutation(len(chosen))
    if len(order) < count:
        order = np.concatenate([order, rng.choice(len(chosen), count - len(order))])
    return points[order], labels[order]


def _queries(
    meshes: tuple[ComponentMesh, ...], count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "queries 3"]:
    """Half uniform in the workspace, half normal about random points of the surfaces [m]."""
    near = count // 2 if meshes else 0
    uniform = rng.uniform(*WORKSPACE, size=(count - near, 3))
    if near == 0:
        return uniform
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]).astype(np.float64)
    surface = _surface_points(corners, near, rng)
    return np.concatenate([uniform, surface + rng.normal(0.0, NEAR_SURFACE, (near, 3))])


def _surface_points(
    triangles: Float64[np.ndarray, "triangles 3 3"], count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "points 3"]:
    """Points uniform by area: square-root barycentric sampling (Osada et al. 2002)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ends = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    face = np.searchsorted(ends, rng.random(count) * ends[-1])
    face = np.minimum(face, len(triangles) - 1)
    root, share = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    return (1 - root) * a[face] + root * (1 - share) * b[face] + root * share * c[face]


def _grid_labels(
    grid: LabelGrid, points: Float64[np.ndarray, "points 3"]
) -> Int64[np.ndarray, " points"]:
    """Label of the nearest node; outside the grid there is nothing."""
    node = np.rint((points - grid.origin) / grid.spacing).astype(np.int64)
    inside = ((node >= 0) & (node < grid.labels.shape)).all(axis=1)
    labels = np.full(len(points), NO_COMPONENT, np.int64)
    labels[inside] = grid.labels[tuple(node[inside].T)]
    return labels


def _tool_points(
    tools: FrameTools, count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "fingers points 3"]:
    """Points on the surface of every finger [m], world."""
    triangles = _finger_triangles(tools.tool)
    return np.stack(
        [
            transform_points(_surface_points(triangles, count, rng), position, quaternion)
            for position, quaternion in zip(tools.position, tools.quaternion, strict=True)
        ]
    )


def _finger_triangles(tool: Tool) -> Float64[np.ndarray, "triangles 3 3"]:
    """Surface of one finger [m], finger frame; a box needs no mesh library."""
    if tool.mesh is not None:
        trimesh = require_package("trimesh", extra="sim")
        mesh = trimesh.load(tool.mesh, force="mesh")
        return np.asarray(mesh.triangles, np.float64) * tool.scale
    corner = np.array(list(np.ndindex(2, 2, 2)), float)
    corner = (corner - [0.0, 0.5, 0.0]) * [tool.depth, tool.width, tool.height]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.concatenate([corner[[[a, b, c], [a, c, d]]] for a, b, c, d in quads])
