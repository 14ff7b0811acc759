"""Frozen records that travel between the stages.

Units are SI. World frame: z up, table at z = 0, origin under the middle of the workspace. Camera
frame: optical (x right, y down, z forward). Quaternions are xyzw. Axes in shapes are named
`frames`, `particles`, `fingers`, `views`, `rows` (image) and `columns` (image).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8, UInt16, UInt32

__all__ = [
    "NO_COMPONENT",
    "SCHEMA_VERSION",
    "SEGMENT_COMPONENT",
    "SEGMENT_NONE",
    "SEGMENT_TABLE",
    "SEGMENT_TOOL",
    "STRAY",
    "Action",
    "Body",
    "Camera",
    "ComponentMesh",
    "ComponentMeshes",
    "DepthViews",
    "FrameTopology",
    "Intrinsics",
    "LabelGrid",
    "Material",
    "Particles",
    "Scene",
    "SceneGraph",
    "Tool",
    "ToolPoses",
    "Topology",
    "TopologyEvent",
]

SCHEMA_VERSION = "1.1"
STRAY = 255  # label of a particle that belongs to no component (a crumb)
NO_COMPONENT = 255  # label-grid value outside every component
SEGMENT_NONE = 0  # a ray that hits nothing
SEGMENT_TABLE = 1
SEGMENT_TOOL = 2
SEGMENT_COMPONENT = 16  # component k is 16 + k


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Elastoplastic dough: Hencky elasticity with von Mises yield.

    The defaults are those of SPEC.md, "Material": soft enough to squeeze, firm enough to stand.
    """

    young_modulus: float = 50e3  # [Pa]
    poisson_ratio: float = 0.4
    density: float = 1300.0  # [kg/m3]
    yield_stress: float = 2e3  # [Pa], von Mises


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One initially connected body: a registered shape, its parameters and where it lies."""

    shape: str  # name in the entry-point group `doughdata.shapes`
    parameters: Mapping[str, float | str] = field(default_factory=dict)  # lengths in [m]
    position: tuple[float, float] = (0.0, 0.0)  # [m], of the shape's origin on the table
    yaw: float = 0.0  # [rad], about world z


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """One finger of a parallel gripper; the other is the same finger turned by pi about z.

    Finger frame: x = closing axis pointing away from the gap, contact face in the plane x = 0,
    y = lateral, centred, z up, lowest point at z = 0. A box unless `mesh` names a file.
    """

    name: str
    depth: float = 0.010  # [m], along the closing axis (box)
    width: float = 0.010  # [m], lateral (box)
    height: float = 0.050  # [m] (box)
    mesh: str | None = None  # path of a watertight mesh in the finger frame, or None for a box
    scale: float = 1.0  # [m per mesh unit]
    friction: float = 0.3  # Coulomb coefficient against dough


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """One squeeze: both fingers close at constant speed, hold, and open again if `release`."""

    tool: int = 0  # index into `Scene.tools`
    position: tuple[float, float] = (0.0, 0.0)  # [m], world, middle of the gap
    yaw: float = 0.0  # [rad]; 0 closes along world x
    opening_start: float = 0.100  # [m], between the contact faces
    opening_end: float = 0.001  # [m]
    speed: float = 0.025  # [m/s], per finger
    hold: float = 0.0  # [s], at the final opening
    release: bool = False  # open to `opening_start` again, at the same speed

    @property
    def duration(self) -> float:
        """Seconds from the first to the last instant of this action."""
        close = (self.opening_start - self.opening_end) / (2.0 * self.speed)
        return close * (2.0 if self.release else 1.0) + self.hold


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """All that defines a scene, independent of resolution. Plain JSON on disk (`v1/scene.json`)."""

    scene_id: str
    family: str
    seed: int = 0
    split: str = "train"  # train | test
    region: str = "train"  # train | interpolation | extrapolation | custom
    bodies: tuple[Body, ...]
    material: Material = Material()
    tools: tuple[Tool, ...]
    actions: tuple[Action, ...]
    table_friction: float = 0.5  # Coulomb coefficient

    @property
    def duration(self) -> float:
        """Seconds of all actions; warm-up comes before and does not count."""
        return sum(action.duration for action in self.actions)


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolPoses:
    """Where both fingers are at every key frame."""

    position: Float64[np.ndarray, "frames fingers 3"]  # [m], finger frame's origin in the world
    quaternion: Float64[np.ndarray, "frames fingers 4"]  # xyzw, finger frame -> world
    opening: Float64[np.ndarray, " frames"]  # [m]
    action: Int32[np.ndarray, " frames"]  # index into `Scene.actions`; its tool is the one present


@dataclass(frozen=True, slots=True, kw_only=True)
class Particles:
    """Result of a simulation: material points at every key frame; order is the same in all."""

    positions: Float32[np.ndarray, "frames particles 3"]  # [m], world
    object_ids: UInt8[np.ndarray, " particles"]  # index into `Scene.bodies`
    timestamps: Float64[np.ndarray, " frames"]  # [s]
    tool_poses: ToolPoses
    spacing: float  # [m], of the initial lattice; one particle stands for spacing**3


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneGraph:
    """Scene-topology graph of one frame: cycle rank of a component = its genus."""

    positions: Float32[np.ndarray, "nodes 3"]  # [m], world
    components: UInt8[np.ndarray, " nodes"]  # label of the component a node belongs to
    particles: Int32[np.ndarray, " nodes"]  # particles that a node stands for
    edges: Int32[np.ndarray, "edges 2"]  # node indices; no self-loops, no doubles


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTopology:
    """Topology of one key frame. Component `k` has label `k` and genus `genus[k]`."""

    labels: UInt8[np.ndarray, " particles"]  # component of a particle, STRAY for crumbs
    genus: tuple[int, ...]
    graph: SceneGraph
    contacts: Int32[np.ndarray, "contacts 2"]  # particle pairs that touch without being merged
    ambiguous_reason: str = ""  # empty = the check is sure

    @property
    def num_components(self) -> int:
        """Number of components, crumbs not counted."""
        return len(self.genus)

    @property
    def ambiguous(self) -> bool:
        """Whether the check's own margins say that it is unsure."""
        return bool(self.ambiguous_reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class TopologyEvent:
    """A change of topology between the key frame before and `frame`."""

    frame: int
    kind: str  # merge | split | self_merge | self_split
    components_before: tuple[int, ...]  # labels in the key frame before
    components_after: tuple[int, ...]  # labels in `frame`
    margin: float  # distance of the decision from its threshold, in units of the threshold


@dataclass(frozen=True, slots=True, kw_only=True)
class Topology:
    """Result of a topology check: one `FrameTopology` a key frame and what happened between."""

    frames: tuple[FrameTopology, ...]
    events: tuple[TopologyEvent, ...]
    static_num_components: Int32[np.ndarray, " frames"]  # the static check, beside it
    static_genus: tuple[tuple[int, ...], ...]  # the same, per frame and component
    bonds_made: tuple[Int32[np.ndarray, "_ 2"], ...]  # particle pairs per frame; frame 0 = all
    bonds_broken: tuple[Int32[np.ndarray, "_ 2"], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentMesh:
    """Closed, outward-oriented triangle mesh of one component."""

    vertices: Float32[np.ndarray, "vertices 3"]  # [m], world
    faces: UInt32[np.ndarray, "faces 3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelGrid:
    """Component label of every grid node, NO_COMPONENT outside. Node i is at origin + i spacing."""

    labels: UInt8[np.ndarray, "nx ny nz"]
    origin: Float64[np.ndarray, " 3"]  # [m], world
    spacing: float  # [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentMeshes:
    """Meshes of one key frame, in the order of the labels, and the label grid for training."""

    meshes: tuple[ComponentMesh, ...]
    label_grid: LabelGrid


@dataclass(frozen=True, slots=True, kw_only=True)
class Intrinsics:
    """Pinhole camera without distortion; pixel (0, 0) has its centre at (0, 0)."""

    width: int
    height: int
    fx: float  # [px]
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A posed camera. The pose maps the optical frame to the world."""

    intrinsics: Intrinsics
    position: tuple[float, float, float]  # [m]
    quaternion: tuple[float, float, float, float]  # xyzw


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthViews:
    """Depth images of one scene. Depth is along the optical axis, 0 = invalid."""

    depth: UInt16[np.ndarray, "views rows columns"]  # in units of `depth_unit`
    segments: UInt8[
        np.ndarray, "views rows columns"
    ]  # SEGMENT_* below; component k = SEGMENT_COMPONENT + k
    frame_index: Int32[np.ndarray, " views"]
    view_index: Int32[np.ndarray, " views"]
    cameras: tuple[Camera, ...]
    depth_unit: float = 1e-4  # [m]
