"""One scene as one HTML file that opens anywhere, without network and without installed software.

The page is plain WebGL 2 (`assets/*.js`, some 30 kB): four kinds of things are drawn, so that a 3D
library would be the bulk of every saved file. Its security policy admits its own script and style,
by their hashes, and nothing else; texts from the dataset are data, never markup.
"""

import html
import json
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from doughdata.geometry import quaternion_to_matrix
from doughdata.view.clouds import RAMP, DepthWindow, depth_windows
from doughdata.view.packing import pack, quantise, smallest_unsigned
from doughdata.view.panels import COLOURS, CRUMB, TOOL
from doughdata.view.projection import LIGHT, View
from doughdata.view.scene_data import (
    SceneData,
    ViewDataset,
    finger_poses_at,
    load_scene,
    scene_title,
)
from doughschemas import BadInputError, ComponentMesh, TopologyEvent

__all__ = ["page_text", "save_page"]

SCRIPTS = ("data.js", "shaders.js", "gl.js", "camera.js", "stage.js", "timeline.js", "page.js")
STEP = 10e-6  # [m], of stored positions: 1/200 of the particles' usual distance
Arrays = dict[str, np.ndarray]


def save_page(
    dataset: ViewDataset,
    path: str | Path,
    *,
    scene: int | None = None,
    sensor: str | None = None,
) -> Path:
    """Save one scene as a page and return its path.

    `scene` is by default the first; `sensor` names a depth layer, by default the first.

    Raises:
        BadInputError: not an `.html` path, a path that cannot be written, an empty dataset, or a
            scene or sensor that is not there.
    """
    path = Path(path)
    if path.suffix.lower() != ".html":
        raise BadInputError(f"a page is saved as .html, got {path.name!r}")
    index = next(iter(dataset.scene_indices), 0) if scene is None else scene
    text = page_text(load_scene(dataset, index, sensor=sensor))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error
    return path


def page_text(data: SceneData) -> str:
    """The page of one scene."""
    arrays: Arrays = {}
    meshes = [data.meshes(frame) for frame in range(data.num_frames)] if data.meshes else []
    low, step = _box(data, meshes)
    header = {
        **_facts(data),
        "box": {"low": low.tolist(), "step": step},
        "style": _style(),
        "tools": _add_tools(arrays, data),
        "meshes": _add_meshes(arrays, meshes, low, step),
        "graph": _add_graph(arrays, data, low, step),
        "depth": _add_depth(arrays, data),
    }
    positions = quantise(data.particles.positions, low, step)
    arrays["positions"] = positions.reshape(len(positions), -1)
    if data.topology:
        arrays["labels"] = np.stack([frame.labels for frame in data.topology.frames])
    # Depth as it is deflates better than its differences, which double the noise.
    header["arrays"], packed = pack(arrays, plain=("depth",))
    return _filled(title=scene_title(data.index, data.scene), header=header, packed=packed)


def _filled(*, title: str, header: Mapping[str, Any], packed: str) -> str:
    """The template with its places filled, once: a text that looks like a place stays text."""
    assets = files("doughdata.view") / "assets"
    script = "\n".join((assets / name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = (assets / "scene.css").read_text(encoding="utf-8")
    script, style = f'"use strict";\n{script}', f"\n{style}"
    safe = json.dumps(header, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        safe = safe.replace(sign, f"\\u{ord(sign):04x}")
    places = {
        "title": html.escape(title),
        "script": script,
        "style": style,
        "script-hash": _hash(script),
        "style-hash": _hash(style),
        "header": safe,
        "packed": packed,
    }
    template = (assets / "page.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{([a-z-]+)\}\}", lambda place: places[place[1]], template)


def _hash(text: str) -> str:
    return "sha256-" + b64encode(sha256(text.encode()).digest()).decode()


def _box(data: SceneData, meshes: Sequence[tuple[ComponentMesh, ...]]) -> tuple[Any, float]:
    """Lowest corner [m] of all positions of the scene, and the step [m] they are stored in."""
    parts = [data.particles.positions.reshape(-1, 3)]
    parts += [mesh.vertices for frame in meshes for mesh in frame]
    parts += [f.graph.positions for f in (data.topology.frames if data.topology else ())]
    parts = [part for part in parts if len(part)]
    low = np.min([part.min(axis=0) for part in parts], axis=0).astype(float)
    high = np.max([part.max(axis=0) for part in parts], axis=0).astype(float)
    return low, max(STEP, float((high - low).max()) / 65535)


def _facts(data: SceneData) -> dict[str, Any]:
    """What is shown as text."""
    scene, topology = data.scene, data.topology
    return {
        "scene": {
            "index": data.index,
            "id": scene.scene_id,
            "family": scene.family,
            "split": scene.split,
            "region": scene.region,
            "seed": scene.seed,
        },
        "toolNames": [tool.name for tool in scene.tools],
        "spacing": float(data.particles.spacing),
        "timestamps": data.particles.timestamps.tolist(),
        "opening": data.particles.tool_poses.opening.tolist(),
        "genus": [list(frame.genus) for frame in topology.frames] if topology else None,
        "ambiguous": [frame.ambiguous_reason for frame in topology.frames] if topology else [],
        "events": [_event(event) for event in topology.events] if topology else [],
        "missing": dict(data.missing),
        "sensor": data.sensor,
    }


def _event(event: TopologyEvent) -> dict[str, Any]:
    # JSON has no infinity: a margin that is none is left out.
    return {**asdict(event), "margin": event.margin if np.isfinite(event.margin) else None}


def _style() -> dict[str, Any]:
    """Colours, light and view of the contact sheet."""
    view = View()
    return {
        "palette": COLOURS.tolist(),
        "crumb": CRUMB.tolist(),
        "tool": [int(TOOL[k : k + 2], 16) / 255 for k in (1, 3, 5)],
        "ramp": RAMP.tolist(),
        "light": LIGHT.tolist(),
        "azimuth": view.azimuth,
        "elevation": view.elevation,
    }


def _add_tools(arrays: Arrays, data: SceneData) -> dict[str, Any]:
    """Finger surfaces, and a 3 x 4 pose for every finger and key frame."""
    for number, shape in enumerate(data.tools):
        arrays[f"tool{number}_vertices"] = shape.vertices
        arrays[f"tool{number}_faces"] = smallest_unsigned(shape.faces)
        arrays[f"tool{number}_edges"] = smallest_unsigned(shape.edges)
    poses = finger_poses_at(data).astype(np.float32)
    arrays["tool_poses"] = poses.reshape(len(poses), -1)
    used = [data.scene.actions[int(action)].tool for action in data.particles.tool_poses.action]
    return {"used": used}


def _add_meshes(
    arrays: Arrays,
    meshes: Sequence[tuple[ComponentMesh, ...]],
    low: Float64[np.ndarray, " 3"],
    step: float,
) -> list[list[tuple[int, int]]] | None:
    """All meshes end to end; returns the vertices and faces of each component, by key frame."""
    flat = [mesh for frame in meshes for mesh in frame]
    if not meshes:
        return None
    vertices = np.concatenate([np.zeros((0, 3), np.float32), *(mesh.vertices for mesh in flat)])
    faces = np.concatenate([np.zeros((0, 3), np.uint32), *(mesh.faces for mesh in flat)])
    arrays["mesh_vertices"] = quantise(vertices, low, step)
    arrays["mesh_faces"] = smallest_unsigned(faces)
    return [[(len(mesh.vertices), len(mesh.faces)) for mesh in frame] for frame in meshes]


def _add_graph(
    arrays: Arrays, data: SceneData, low: Float64[np.ndarray, " 3"], step: float
) -> list[tuple[int, int]] | None:
    """All scene graphs end to end; returns the number of nodes and edges, by key frame."""
    if data.topology is None:
        return None
    graphs = [frame.graph for frame in data.topology.frames]
    arrays["graph_nodes"] = quantise(np.concatenate([g.positions for g in graphs]), low, step)
    for name in ("components", "particles"):
        values = np.concatenate([getattr(graph, name) for graph in graphs])[:, None]
        arrays[f"graph_{name}"] = smallest_unsigned(values)
    arrays["graph_edges"] = smallest_unsigned(
        np.concatenate([graph.edges.reshape(-1, 2) for graph in graphs])
    )
    return [(len(graph.positions), len(graph.edges)) for graph in graphs]


def _add_depth(arrays: Arrays, data: SceneData) -> dict[str, Any] | None:
    """All pixels end to end, row by row; returns where each view lies and how it looks."""
    if data.depth is None:
        return None
    windows = depth_windows(data.depth, data.particles.positions)
    pixels = [window.depth.reshape(-1, 1) for window in windows]
    arrays["depth"] = np.concatenate([np.zeros((0, 1), np.uint16), *pixels])
    return {"unit": data.depth.depth_unit, "windows": [_window(window) for window in windows]}


def _window(window: DepthWindow) -> dict[str, Any]:
    camera = window.camera
    return {
        "frame": window.frame,
        "stride": window.stride,
        **asdict(camera.intrinsics),
        "position": list(camera.position),
        "rotation": quaternion_to_matrix(np.array(camera.quaternion)).ravel().tolist(),
    }
