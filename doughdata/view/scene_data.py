"""What a viewer shows of one scene, read from a dataset; a layer that was not made has a reason."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from jaxtyping import Float32, Float64, Int64

from doughdata.geometry import quaternion_to_matrix
from doughdata.scenes.tools import finger_mesh
from doughdata.view.recorded import recorded_scenes
from doughschemas import (
    BadInputError,
    ComponentMesh,
    DepthViews,
    MissingLayerError,
    Particles,
    Scene,
    Tool,
    Topology,
)

__all__ = [
    "SceneData",
    "ToolShape",
    "ViewDataset",
    "chosen_sensor",
    "finger_poses_at",
    "load_scene",
    "ranges",
    "scene_title",
    "tool_shape",
]

CREASE = 0.90  # cosine between face normals below which a tool's edge is drawn
T = TypeVar("T")


class ViewDataset(Protocol):
    """What the views need of `doughdata.open_dataset(...)`.

    `frame(...)` gives `.meshes` and `.depth(sensor)`; what is missing raises `MissingLayerError`.
    """

    @property
    def uri(self) -> str:
        """Where the dataset lies."""
        ...

    @property
    def layers(self) -> Iterable[str]:
        """Names of the layers that exist."""
        ...

    @property
    def scene_indices(self) -> Sequence[int]:
        """Scenes that have particles."""
        ...

    @property
    def scenes(self) -> Any:
        """Table of the same scenes, in the same order, with `scene_index` and `scene_id`."""
        ...

    def scene(self, scene_index: int) -> Scene:
        """The scene's definition."""
        ...

    def read_particles(self, scene_index: int) -> Particles:
        """All key frames."""
        ...

    def read_topology(self, scene_index: int) -> Topology:
        """All key frames."""
        ...

    def read_depth(self, scene_index: int, sensor: str) -> DepthViews:
        """All views from one sensor."""
        ...

    def frame(self, *, scene: int, frame: int) -> Any:
        """One key frame, lazily read."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolShape:
    """A finger in its own frame, with the edges worth drawing."""

    vertices: Float32[np.ndarray, "vertices 3"]  # [m], finger frame
    faces: Int64[np.ndarray, "faces 3"]  # outward
    edges: Int64[np.ndarray, "edges 2"]  # creases and borders, by vertex


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneData:
    """One scene; `topology`, `meshes` and `depth` are None where `missing` has the reason."""

    index: int
    scene: Scene
    particles: Particles
    tools: tuple[ToolShape, ...]  # in the order of `scene.tools`
    topology: Topology | None
    meshes: Callable[[int], tuple[ComponentMesh, ...]] | None  # reads one key frame
    depth: DepthViews | None
    sensor: str  # of `depth`; "" where no depth layer is in the dataset
    missing: Mapping[str, str]  # layer (topology, mesh, depth) -> why, and what makes it

    @property
    def num_frames(self) -> int:
        """Key frames."""
        return len(self.particles.timestamps)


def load_scene(dataset: ViewDataset, index: int, *, sensor: str | None = None) -> SceneData:
    """Read one scene; `sensor` names its depth layer, by default the first.

    Raises:
        BadInputError: no such scene or sensor.
        DatasetError: a committed file is damaged.
    """
    there = list(dataset.scene_indices)
    if not there:
        raise BadInputError("the dataset holds no scene yet: run `doughdata generate` first")
    if index not in there:
        raise BadInputError(f"no scene {index}: the dataset holds {ranges(there)}")
    if index in recorded_scenes(dataset):
        raise BadInputError(
            f"scene {index} is a recording: `doughdata view --scene {index} --save X.png` shows it"
        )
    sensor = chosen_sensor(dataset, sensor)
    missing: dict[str, str] = {}

    def maybe(layer: str, read: Callable[[], T]) -> T | None:
        try:
            return read()
        except MissingLayerError as error:
            # The page may be sent to somebody else: it says what to type, not where the data lay.
            text = str(error).replace(f" --dataset {dataset.uri}", "")
            missing[layer] = text.replace(f"{dataset.uri}: ", "")
            return None

    def meshes(frame: int) -> tuple[ComponentMesh, ...]:
        return dataset.frame(scene=index, frame=frame).meshes

    scene = dataset.scene(index)
    depth = maybe("depth", lambda: dataset.read_depth(index, sensor)) if sensor else None
    if not sensor:
        missing["depth"] = "no depth layer; make it with `doughdata render --noise realsense`"
    return SceneData(
        index=index,
        scene=scene,
        particles=dataset.read_particles(index),
        tools=tuple(tool_shape(tool) for tool in scene.tools),
        topology=maybe("topology", lambda: dataset.read_topology(index)),
        meshes=meshes if maybe("mesh", lambda: meshes(0)) is not None else None,
        depth=depth,
        sensor=sensor,
        missing=missing,
    )


def ranges(indices: Sequence[int]) -> str:
    """Sorted indices in short, as 0..3, 5, 7..9."""
    runs: list[list[int]] = []
    for index in indices:
        if runs and index == runs[-1][1] + 1:
            runs[-1][1] = index
        else:
            runs.append([index, index])
    return ", ".join(f"{first}..{last}" if first < last else f"{first}" for first, last in runs)


def chosen_sensor(dataset: ViewDataset, wanted: str | None) -> str:
    """The wanted depth layer, or the first one, or "" where there is none.

    Raises:
        BadInputError: no depth of the wanted sensor was made.
    """
    made = [layer.partition(".")[2] for layer in dataset.layers if layer.startswith("depth.")]
    if wanted is not None and wanted not in made:
        raise BadInputError(
            f"no depth of sensor {wanted!r} (there is: {', '.join(made) or 'none'}); "
            f"make it with `doughdata render --noise {wanted}`"
        )
    return wanted or next(iter(made), "")


def scene_title(index: int, scene: Scene) -> str:
    """One line: index, name, split (and region where it says more), tools."""
    tools = ", ".join(dict.fromkeys(scene.tools[action.tool].name for action in scene.actions))
    region = "" if scene.region in (scene.split, "custom") else f" ({scene.region})"
    parts = [f"scene {index}", scene.scene_id, f"{scene.split}{region}", f"tool: {tools}"]
    return "  \N{MIDDLE DOT}  ".join(parts)


def tool_shape(tool: Tool) -> ToolShape:
    """Surface of one finger; a box needs no mesh library.

    Raises:
        SceneError: the mesh file is missing or not watertight.
        MissingPackageError: the tool is a mesh and trimesh is not installed.
    """
    if tool.mesh is not None:
        mesh = finger_mesh(tool)
        vertices = np.asarray(mesh.vertices, np.float32)
        faces = np.asarray(mesh.faces, np.int64)
    else:
        x, y, z = np.meshgrid(
            [0.0, tool.depth], [-tool.width / 2, tool.width / 2], [0.0, tool.height], indexing="ij"
        )
        vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = np.array([half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))])
    return ToolShape(vertices=vertices, faces=faces, edges=_creases(vertices, faces))


def _creases(
    vertices: Float32[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> Int64[np.ndarray, "edges 2"]:
    """Edges whose two faces differ in direction, and edges with any other number of faces."""
    corners = vertices[faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, place, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    # For an edge of two faces, |n1 + n2|^2 = 2 + 2 cos.
    total = np.zeros((len(edges), 3))
    np.add.at(total, place.reshape(-1), np.repeat(normal, 3, axis=0))
    flat = (count == 2) & ((total**2).sum(axis=1) / 2 - 1 > CREASE)
    return edges[~flat].astype(np.int64)


def finger_poses_at(data: SceneData) -> Float64[np.ndarray, "frames fingers 3 4"]:
    """Finger frame -> world at every key frame: rotation, then position [m] as last column."""
    poses = data.particles.tool_poses
    rotation = quaternion_to_matrix(poses.quaternion)
    return np.concatenate([rotation, poses.position[..., None]], axis=-1)
