"""The page of a prediction: three lanes on one stage, observation, prediction and truth.

It is the page of a scene (`doughdata.view.html`) whose dough stands there three times, side by side
along x: seen points on the left, predicted meshes in the middle, true ones on the right.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int64

from doughcli.net_surfaces import closed_surface
from doughdata.registry import require_package
from doughdata.view.html import page_text
from doughdata.view.scene_data import SceneData, tool_shape
from doughschemas import (
    Action,
    BadInputError,
    ComponentMesh,
    FrameTopology,
    Particles,
    Scene,
    SceneGraph,
    Tool,
    ToolPoses,
    Topology,
)

__all__ = ["save_prediction"]

LANE = 0.17  # [m] from one lane to the next
LANES = ("observation", "prediction", "truth")
SHOWN_POINTS = 512  # a frame and lane
MARKER = 0.8e-3  # [m], from the middle of a seen point's marker to its corners
CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
Surface = tuple[Float32[np.ndarray, "vertices 3"], Int64[np.ndarray, "faces 3"]]
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def save_prediction(prediction: Any, scene: Scene | None, path: Path) -> None:
    """Write the page of a `doughnet.predict.Prediction`; `scene` is None of a recording.

    Raises:
        BadInputError: the path cannot be written.
    """
    text = page_text(_page_data(prediction, scene))
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error


def _page_data(prediction: Any, scene: Scene | None) -> SceneData:
    frames = prediction.frames
    meshes = [_meshes(frame, prediction.lattice) for frame in frames]
    there = scene is not None and prediction.rolled_out
    scene = scene or _recording(prediction.scene_index)
    how = "predicted from the first view" if prediction.rolled_out else "from its own view"
    last = frames[-1]
    notes = {
        LANES[0]: "left, the points that the camera saw",
        LANES[1]: f"middle, each frame {how}; c and g are its own",
    }
    if last.true_genus is not None:
        notes[LANES[2]] = f"right; ends with genus {', '.join(map(str, last.true_genus))}"
    return SceneData(
        index=prediction.scene_index,
        scene=replace(scene, scene_id=f"{scene.scene_id}: {', '.join(notes)}"),
        particles=_particles(frames, meshes, there),
        tools=tuple(tool_shape(tool) for tool in scene.tools),
        topology=_topology(frames, meshes),
        meshes=meshes.__getitem__,
        depth=None,
        sensor="",
        missing=notes,  # the page lists these lines beside the stage
    )


def _recording(index: int) -> Scene:
    """What is known of a scene that was recorded; its tool, which is not, is too small to see."""
    return Scene(
        scene_id=f"recording-{index}",
        family="recording",
        split="real",
        region="custom",
        bodies=(),
        tools=(Tool(name="unknown", depth=1e-6, width=1e-6, height=1e-6),),
        actions=(Action(),),
    )


def _particles(
    frames: Sequence[Any], meshes: Sequence[tuple[ComponentMesh, ...]], with_tools: bool
) -> Particles:
    points = np.stack([_lanes(shown) for shown in meshes])
    fingers = len(frames[0].tools.position) if with_tools else 2
    position = np.zeros((len(frames), 3 * fingers, 3))
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(frames), 3 * fingers, 1))
    for k, frame in enumerate(frames if with_tools else ()):
        for lane in range(3):
            part = slice(lane * fingers, (lane + 1) * fingers)
            position[k, part] = frame.tools.position + np.array([(lane - 1) * LANE, 0.0, 0.0])
            quaternion[k, part] = frame.tools.quaternion
    tools = [frame.tools for frame in frames]
    return Particles(
        positions=points,
        object_ids=np.zeros(points.shape[1], np.uint8),
        timestamps=np.array([frame.timestamp for frame in frames], float),
        tool_poses=ToolPoses(
            position=position,
            quaternion=quaternion,
            opening=np.array([tool.opening if with_tools else 0.0 for tool in tools]),
            action=np.array([tool.action if with_tools else 0 for tool in tools], np.int32),
        ),
        spacing=0.002,
    )


def _lanes(meshes: tuple[ComponentMesh, ...]) -> Float32[np.ndarray, "points 3"]:
    """A fixed number of points on all that is shown of a frame, in the order of the meshes."""
    return np.concatenate([mesh.vertices for mesh in meshes])[_chosen(meshes)]


def _chosen(meshes: tuple[ComponentMesh, ...]) -> Int64[np.ndarray, " points"]:
    count = sum(len(mesh.vertices) for mesh in meshes)
    return np.linspace(0, count - 1, 3 * SHOWN_POINTS).astype(np.int64)


def _topology(frames: Sequence[Any], meshes: Sequence[tuple[ComponentMesh, ...]]) -> Topology:
    graph = SceneGraph(
        positions=np.zeros((0, 3), np.float32),
        components=np.zeros(0, np.uint8),
        particles=np.zeros(0, np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    found = []
    for frame, shown in zip(frames, meshes, strict=True):
        counts = [len(mesh.vertices) for mesh in shown]
        labels = np.repeat(np.arange(len(shown)), counts)[_chosen(shown)]
        found.append(
            FrameTopology(
                labels=labels.astype(np.uint8),
                genus=tuple(genus for genus in frame.shape.genus if genus is not None),
                graph=graph,
                contacts=np.zeros((0, 2), np.int32),
            )
        )
    none = tuple(np.zeros((0, 2), np.int32) for _ in frames)
    return Topology(
        frames=tuple(found),
        events=(),
        static_num_components=np.zeros(len(frames), np.int32),
        static_genus=tuple(() for _ in frames),
        bonds_made=none,
        bonds_broken=none,
    )


def _meshes(frame: Any, lattice: Any) -> tuple[ComponentMesh, ...]:
    """All lanes of a frame; a component has one place, and so one colour, in all of them."""
    labels, genus = frame.shape.components()
    predicted = labels.numpy()
    parts = [(predicted == k) for k in range(len(genus))]
    places: dict[int, int] = {}
    shown = [(k, closed_surface(part, lattice)) for k, part in enumerate(parts)]
    if frame.true_labels is not None:
        true = frame.true_labels.numpy()
        places = {k: place for place, k in _matched(parts, true, len(frame.true_genus))}
        shown += [(places[k], _moved(closed_surface(true == k, lattice), LANE)) for k in places]
    for k in range(frame.point_labels.max() + 1):
        seen = frame.points[frame.point_labels == k]
        shown.append((places.get(k, k), _markers(seen - [LANE, 0.0, 0.0])))
    most = max((place for place, _ in shown), default=0)
    return tuple(
        _joined(surface for place, surface in shown if place == k) for k in range(most + 1)
    )


def _moved(surface: Surface, along: float) -> Surface:
    return surface[0] + np.array([along, 0.0, 0.0], np.float32), surface[1]


def _markers(
    points: Float64[np.ndarray, "points 3"],
) -> tuple[Float32[np.ndarray, "vertices 3"], Int64[np.ndarray, "faces 3"]]:
    """A small tetrahedron about every point [m]."""
    vertices = (points[:, None] + MARKER * CORNERS).reshape(-1, 3).astype(np.float32)
    faces = (len(CORNERS) * np.arange(len(points))[:, None, None] + SIDES).reshape(-1, 3)
    return vertices, faces


def _matched(parts: list[np.ndarray], true: np.ndarray, count: int) -> Iterator[tuple[int, int]]:
    """(place, true component): the predicted one that overlaps it most, else a place of its own."""
    optimize = require_package("scipy.optimize", extra="train")
    overlap = np.array([[np.sum(part & (true == k)) for k in range(count)] for part in parts])
    overlap = overlap.reshape(len(parts), count)
    places, components = optimize.linear_sum_assignment(overlap, maximize=True)
    pairs = dict(zip(components.tolist(), places.tolist(), strict=True))
    free = iter(range(len(parts), len(parts) + count))
    for k in range(count):
        yield (pairs[k] if k in pairs else next(free)), k


def _joined(parts: Iterator[tuple[np.ndarray, np.ndarray]]) -> ComponentMesh:
    vertices, faces, start = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.int64)], 0
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + start)
        start += len(points)
    return ComponentMesh(
        vertices=np.concatenate(vertices), faces=np.concatenate(faces).astype(np.uint32)
    )
