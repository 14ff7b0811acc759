"""One panel each: particles, mesh, depth and scene graph of one key frame, on matplotlib axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from doughdata.registry import require_package
from doughdata.view.projection import View, convex_outline, shaded_faces
from doughschemas import SEGMENT_COMPONENT, SEGMENT_TOOL, STRAY, ComponentMesh, FrameTopology

__all__ = [
    "COLOURS",
    "Picture",
    "depth_crop",
    "draw_depth",
    "draw_graph",
    "draw_mesh",
    "draw_particles",
]

COLOURS = np.array(  # component k has colour k mod 8; told apart by the colour-blind, too
    [
        [0.20, 0.47, 0.76],
        [0.95, 0.55, 0.13],
        [0.27, 0.65, 0.42],
        [0.84, 0.31, 0.36],
        [0.58, 0.43, 0.75],
        [0.25, 0.70, 0.74],
        [0.88, 0.73, 0.20],
        [0.60, 0.44, 0.34],
    ]
)
CRUMB = np.array([0.55, 0.55, 0.55])
TOOL = "#5b6470"
TABLE = "#f3f1ec"
INVALID = "#e8477d"  # no colour of the depth map comes near it


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What the panels of one key frame show; a layer that is not there yet is None."""

    positions: Float32[np.ndarray, "particles 3"]  # [m], world
    fingers: Sequence[Float[np.ndarray, "points 3"]] = ()  # [m], world, corners of each finger
    topology: FrameTopology | None = None
    meshes: Sequence[ComponentMesh] | None = None
    depth: Float32[np.ndarray, "rows columns"] | None = None  # [m], 0 = invalid
    segments: UInt8[np.ndarray, "rows columns"] | None = None


def draw_particles(axes: Any, picture: Picture, view: View) -> None:
    """Particles in the colour of their component, crumbs grey, nearer ones lighter."""
    _stage(axes, picture, view)
    points, near = view.project(picture.positions)
    colour = _particle_colours(picture)
    span = np.ptp(near) or 1.0
    light = 0.62 + 0.45 * (near - near.min()) / span
    order = np.argsort(near)
    axes.scatter(
        *points[order].T,
        s=_marker_size(axes, picture),
        c=np.clip(colour * light[:, None], 0, 1)[order],
        linewidths=0,
        zorder=3,
    )
    _fingers(axes, picture, view)


def draw_mesh(axes: Any, picture: Picture, view: View) -> None:
    """Component meshes, shaded, in painter's order."""
    collections = require_package("matplotlib.collections", extra="view")
    _stage(axes, picture, view)
    parts = [
        shaded_faces(mesh.vertices, mesh.faces, COLOURS[k % len(COLOURS)], view)
        for k, mesh in enumerate(picture.meshes or ())
        if len(mesh.faces)
    ]
    if parts:
        corners, rgb, near = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.argsort(near)
        axes.add_collection(
            collections.PolyCollection(
                # A hairline in the face's own colour closes the seams of anti-aliasing.
                corners[order],
                facecolors=rgb[order],
                edgecolors=rgb[order],
                linewidths=0.25,
                zorder=3,
            )
        )
    _fingers(axes, picture, view)


def draw_graph(axes: Any, picture: Picture, view: View) -> None:
    """Scene graph over the faint particles: nodes by their share of particles, edges as lines."""
    if picture.topology is None:
        return
    _stage(axes, picture, view)
    points, _ = view.project(picture.positions)
    faint = 1 - (1 - _particle_colours(picture)) * 0.25
    axes.scatter(*points.T, s=_marker_size(axes, picture), c=faint, linewidths=0, zorder=2)
    graph = picture.topology.graph
    if not len(graph.positions):
        return
    nodes, _ = view.project(graph.positions)
    for a, b in graph.edges:
        axes.plot(*nodes[[a, b]].T, color="#2b2b2b", linewidth=1.2, zorder=4)
    share = graph.particles / max(int(graph.particles.max()), 1)
    axes.scatter(
        *nodes.T,
        s=14 + 46 * share,
        c=COLOURS[graph.components % len(COLOURS)],
        edgecolors="#2b2b2b",
        linewidths=0.8,
        zorder=5,
    )
    _fingers(axes, picture, view)


def draw_depth(axes: Any, picture: Picture, crop: tuple[slice, slice]) -> None:
    """Part of the depth image (see `depth_crop`), lit from the side; invalid pixels pink.

    Hue is depth, brightness is the slope across the picture, which shows dough on a tilted table,
    and noise, better than depth alone.
    """
    if picture.depth is None:
        return
    matplotlib = require_package("matplotlib", extra="view")
    depth = picture.depth[crop]
    valid = depth > 0
    low, high = np.percentile(depth[valid], [1, 99]) if valid.any() else (0.0, 1.0)
    hue = matplotlib.colormaps["viridis_r"]((depth - low) / max(high - low, 1e-3))[..., :3]
    image = np.clip(hue * _slope_light(depth, valid)[..., None], 0, 1)
    image[~valid] = matplotlib.colors.to_rgb(INVALID)
    axes.imshow(image, interpolation="nearest", aspect="auto")
    label = f"{low:.2f}\N{EN DASH}{high:.2f} m" if valid.any() else "no valid pixel"
    axes.text(
        0.97, 0.04, label, transform=axes.transAxes, ha="right", va="bottom", fontsize=6.5,
        color="white", bbox={"facecolor": "black", "alpha": 0.45, "pad": 1.5, "linewidth": 0},
    )  # fmt: skip


def _slope_light(
    depth: Float32[np.ndarray, "rows columns"], valid: Bool[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "rows columns"]:
    """Brightness about 1 from the depth step to the right, over the picture's usual slope."""
    step = np.zeros(depth.shape)
    both = valid[:, 1:] & valid[:, :-1]
    step[:, 1:] = np.where(both, np.diff(depth.astype(float), axis=1), 0.0)
    down = np.abs(np.diff(depth.astype(float), axis=0))[valid[1:] & valid[:-1]]
    usual = max(float(np.median(down)) if len(down) else 0.0, 1e-4)
    return 1.0 - 0.35 * np.tanh(step / usual)


def _particle_colours(picture: Picture) -> Float[np.ndarray, "particles 3"]:
    if picture.topology is None:
        return np.broadcast_to(COLOURS[0], (len(picture.positions), 3))
    labels = picture.topology.labels
    return np.where((labels == STRAY)[:, None], CRUMB, COLOURS[labels % len(COLOURS)])


def _stage(axes: Any, picture: Picture, view: View) -> None:
    """The table's colour and the shadow that the dough throws straight down."""
    axes.set_facecolor(TABLE)
    shadow, _ = view.project(np.asarray(picture.positions) * [1.0, 1.0, 0.0])
    axes.scatter(*shadow.T, s=4 * _marker_size(axes, picture), c="#dcd8cf", linewidths=0, zorder=1)


def _fingers(axes: Any, picture: Picture, view: View) -> None:
    patches = require_package("matplotlib.patches", extra="view")
    for points in picture.fingers:
        outline = convex_outline(view.project(points)[0])
        axes.add_patch(
            patches.Polygon(
                outline, closed=True, facecolor=(0.36, 0.39, 0.44, 0.16), edgecolor=TOOL,
                linewidth=0.8, zorder=6,
            )
        )  # fmt: skip


def _marker_size(axes: Any, picture: Picture) -> float:
    """Area [pt2] of a disc as wide as the particles' distance (median over a sample)."""
    points = np.asarray(picture.positions, float)
    if len(points) < 2:
        return 20.0
    sample = points[:: max(len(points) // 64, 1)]
    distance = np.linalg.norm(sample[:, None] - points[None], axis=2)
    nearest = float(np.median(np.partition(distance, 1, axis=1)[:, 1]))
    low, high = axes.get_xlim()
    points_a_metre = axes.get_position().width * axes.figure.get_figwidth() * 72 / (high - low)
    return float(np.clip((1.3 * nearest * points_a_metre) ** 2, 0.5, 60.0))


def depth_crop(pictures: Sequence[Picture]) -> tuple[slice, slice]:
    """Rows and columns that hold the dough in all pictures, with a margin, in the shape 4 : 3.

    Tools count where no dough is seen; without either it is the whole image.
    """
    shape = next((p.depth.shape for p in pictures if p.depth is not None), (1, 1))
    images = [p.segments for p in pictures if p.segments is not None and p.segments.shape == shape]
    where = np.zeros((0, 2), int)
    for least in (SEGMENT_COMPONENT, SEGMENT_TOOL):
        if not len(where):
            where = np.concatenate([where, *(np.argwhere(image >= least) for image in images)])
    if not len(where):
        return slice(0, shape[0]), slice(0, shape[1])
    low, high = where.min(axis=0), where.max(axis=0) + 1
    middle, size = (low + high) / 2, np.maximum((high - low) * 1.7, 24)
    extent = np.minimum(np.maximum(size, size[::-1] * [3 / 4, 4 / 3]), shape).astype(int)
    start = np.clip(middle - extent / 2, 0, np.array(shape) - extent).astype(int)
    stop = start + extent
    return slice(start[0], stop[0]), slice(start[1], stop[1])
