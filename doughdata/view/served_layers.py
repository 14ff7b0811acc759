"""The layers of one key frame as nodes of a viser scene."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from doughdata.view.clouds import DepthWindow, ramp_colours, window_points
from doughdata.view.panels import COLOURS, CRUMB, TOOL
from doughdata.view.scene_data import SceneData, finger_poses_at
from doughschemas import STRAY

__all__ = ["LAYERS", "add_layer", "depth_frame"]

TOOL_RGB = tuple(int(TOOL[k : k + 2], 16) for k in (1, 3, 5))
INK = (43, 43, 43)
GLASS = 0.7  # opacity of meshes that something shines through
Nodes = list[Any]  # handles, to be removed before the next key frame


def add_layer(
    layer: str,
    scene: Any,
    data: SceneData,
    frame: int,
    *,
    windows: list[DepthWindow],
    glass: bool,
) -> Nodes:
    """Add a layer of a key frame to `viser`'s scene API; nothing where it was not made.

    `glass` makes meshes translucent.
    """
    return LAYERS[layer](scene, data, frame, windows, glass)


def depth_frame(windows: list[DepthWindow], frame: int) -> int:
    """The key frame whose depth is shown at `frame`: the last rendered one, or the first."""
    frames = sorted({window.frame for window in windows})
    before = [rendered for rendered in frames if rendered <= frame]
    return before[-1] if before else frames[0] if frames else frame


def _particles(scene: Any, data: SceneData, frame: int, *_: Any) -> Nodes:
    positions = data.particles.positions[frame]
    colours = np.broadcast_to(COLOURS[0], (len(positions), 3))
    if data.topology:
        labels = data.topology.frames[frame].labels
        colours = np.where((labels == STRAY)[:, None], CRUMB, COLOURS[labels % len(COLOURS)])
    return [
        scene.add_point_cloud(
            "/particles",
            points=positions,
            colors=_bytes(colours),
            point_size=1.1 * data.particles.spacing,
            point_shape="circle",
            precision="float32",
        )
    ]


def _meshes(scene: Any, data: SceneData, frame: int, _: Any, glass: bool) -> Nodes:
    return [
        scene.add_mesh_simple(
            f"/mesh/{number}",
            vertices=mesh.vertices,
            faces=mesh.faces,
            color=tuple(_bytes(COLOURS[number % len(COLOURS)]).tolist()),
            opacity=GLASS if glass else None,
        )
        for number, mesh in enumerate(data.meshes(frame) if data.meshes else ())
        if len(mesh.faces)
    ]


def _tools(scene: Any, data: SceneData, frame: int, *_: Any) -> Nodes:
    tool = data.tools[data.scene.actions[int(data.particles.tool_poses.action[frame])].tool]
    nodes: Nodes = []
    for number, pose in enumerate(finger_poses_at(data)[frame]):
        vertices = (tool.vertices @ pose[:, :3].T + pose[:, 3]).astype(np.float32)
        nodes.append(
            scene.add_mesh_simple(
                f"/gripper/{number}/faces",
                vertices=vertices,
                faces=tool.faces,
                color=TOOL_RGB,
                opacity=0.2,
                side="double",
                cast_shadow=False,
            )
        )
        nodes += _segments(scene, f"/gripper/{number}/edges", vertices[tool.edges], TOOL_RGB, 1.5)
    return nodes


def _depth(scene: Any, data: SceneData, frame: int, windows: list[DepthWindow], *_: Any) -> Nodes:
    if data.depth is None:
        return []
    shown = depth_frame(windows, frame)
    nodes: Nodes = []
    for number, window in enumerate(w for w in windows if w.frame == shown):
        points = window_points(window, unit=data.depth.depth_unit)
        if not len(points):
            continue
        depth = window.depth[window.depth > 0] * data.depth.depth_unit
        low, high = np.percentile(depth, [1, 99])
        nodes.append(
            scene.add_point_cloud(
                f"/depth/{number}",
                points=points.astype(np.float32),
                colors=_bytes(ramp_colours((depth - low) / max(high - low, 1e-3))),
                point_size=0.45 * float(np.median(depth)) / window.camera.intrinsics.fx,
                point_shape="circle",
                precision="float32",
            )
        )
    return nodes


def _graph(scene: Any, data: SceneData, frame: int, *_: Any) -> Nodes:
    if data.topology is None or not len(data.topology.frames[frame].graph.positions):
        return []
    graph = data.topology.frames[frame].graph
    nodes = [
        scene.add_point_cloud(
            "/graph/nodes",
            points=graph.positions,
            colors=_bytes(COLOURS[graph.components % len(COLOURS)]),
            point_size=1.1 * data.particles.spacing,
            point_shape="circle",
            precision="float32",
        )
    ]
    return nodes + _segments(scene, "/graph/edges", graph.positions[graph.edges], INK, 3.0)


def _segments(scene: Any, name: str, points: np.ndarray, colour: Any, pixels: float) -> Nodes:
    """Lines (segments, 2, 3) of a width in pixels; viser takes no empty set."""
    if not len(points):
        return []
    return [
        scene.add_line_segments(
            name, points=points, colors=colour, thickness=pixels, thickness_units="screen"
        )
    ]


def _bytes(colours: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(colours, 0, 1) * 255).astype(np.uint8)


LAYERS: Mapping[str, Callable[..., Nodes]] = MappingProxyType(
    {
        "particles": _particles,
        "mesh": _meshes,
        "tools": _tools,
        "depth": _depth,
        "graph": _graph,
    }
)
