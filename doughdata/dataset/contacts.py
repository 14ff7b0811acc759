"""What touches what in a key frame: dough and fingers, dough and table, pieces of dough.

A particle stands for a cube as wide as the spacing, so its dough ends half a spacing beyond its
centre. It touches a finger or the table if its centre is within REACH spacings of them: a gap of
less than a quarter of a spacing is none that particles can show.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from doughdata.geometry import quaternion_to_matrix
from doughdata.registry import require_package
from doughdata.scenes import finger_mesh
from doughschemas import STRAY, FrameTopology, Particles, Scene, Tool

__all__ = [
    "CONTACT_COLUMNS",
    "FrameContacts",
    "contact_arrays",
    "particle_contacts",
    "piece_contacts",
]

REACH = 0.75  # [spacings], from a particle's centre to a surface that it touches
CONTACT_COLUMNS = {  # layer -> columns of its table `frames`; SPEC.md says what they mean
    "sim": [
        ("tool_contact", pa.bool_()),
        ("finger_contacts", pa.list_(pa.int32())),
        ("table_contacts", pa.int32()),
    ],
    "topology": [("touching_components", pa.int32()), ("self_contact", pa.bool_())],
}
Distances = Float64[np.ndarray, " points"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameContacts:
    """What touches in one key frame; None = not known."""

    fingers: tuple[int, ...] | None  # particles that touch each finger
    table: int | None  # particles that touch the table
    components: int | None  # pairs of components that touch without being merged
    itself: bool | None  # a component touches itself without being merged there


def particle_contacts(particles: Particles, scene: Scene) -> dict[str, list[Any]]:
    """Columns of layer `sim`, one value a key frame. Tool meshes have paths on this machine.

    A frame whose action the scene does not have gives None for the fingers.

    Raises:
        MissingPackageError: a mesh tool needs trimesh and Open3D.
        SceneError: a tool's mesh cannot be read.
    """
    reach, poses = REACH * particles.spacing, particles.tool_poses
    solids = {k: _Finger(tool) for k, tool in enumerate(scene.tools)}
    columns: dict[str, list[Any]] = {name: [] for name, _ in CONTACT_COLUMNS["sim"]}
    for frame, points in enumerate(particles.positions.astype(np.float64)):
        action = int(poses.action[frame])
        counts: list[int] | None = None
        if 0 <= action < len(scene.actions):
            finger = solids[scene.actions[action].tool]
            places = zip(poses.position[frame], poses.quaternion[frame], strict=True)
            counts = [finger.count(points, *place, reach=reach) for place in places]
        columns["tool_contact"].append(None if counts is None else any(counts))
        columns["finger_contacts"].append(counts)
        columns["table_contacts"].append(int(np.count_nonzero(points[:, 2] <= reach)))
    return columns


def piece_contacts(frames: Iterable[FrameTopology]) -> dict[str, list[Any]]:
    """Columns of layer `topology`, one value a key frame. Crumbs do not count."""
    columns: dict[str, list[Any]] = {name: [] for name, _ in CONTACT_COLUMNS["topology"]}
    for frame in frames:
        known = ((frame.contacts >= 0) & (frame.contacts < len(frame.labels))).all(axis=1)
        labels = np.sort(frame.labels[frame.contacts[known]].reshape(-1, 2), axis=1)
        labels = labels[labels[:, 1] != STRAY]
        apart = labels[labels[:, 0] != labels[:, 1]]
        columns["touching_components"].append(len(np.unique(apart, axis=0)))
        columns["self_contact"].append(len(apart) < len(labels))
    return columns


def contact_arrays(layer: str, columns: Mapping[str, Sequence[Any]]) -> dict[str, pa.Array]:
    """The columns with their types."""
    return {name: pa.array(columns[name], kind) for name, kind in CONTACT_COLUMNS[layer]}


class _Finger:
    """The solid of one finger, in its own frame."""

    def __init__(self, tool: Tool) -> None:
        self._scene: Any = None
        self._box = np.array(
            [
                [0.0, -tool.width / 2, 0.0],
                [tool.depth, tool.width / 2, tool.height],
            ]
        )
        if tool.mesh is not None:
            mesh = finger_mesh(tool)
            self._box = np.asarray(mesh.bounds, np.float64)
            geometry = require_package("open3d", extra="render").t.geometry
            self._scene = geometry.RaycastingScene(nthreads=1)
            self._scene.add_triangles(
                np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
            )

    def count(
        self, points: np.ndarray, position: np.ndarray, quaternion: np.ndarray, *, reach: float
    ) -> int:
        """How many points [m, world] lie in a posed finger or within `reach` [m] of it."""
        if not np.any(quaternion) or not np.isfinite([*position, *quaternion]).all():
            return 0  # no pose: `validate --deep` says so
        points = points[np.isfinite(points).all(axis=1)]
        local = (points - position) @ quaternion_to_matrix(quaternion)
        low, high = self._box
        outside = np.maximum(np.maximum(low - local, local - high), 0.0)
        near = (outside**2).sum(axis=1) <= reach**2
        if self._scene is None or not near.any():
            return int(np.count_nonzero(near))
        # Three rays a point decide about inside: one may slip through an edge.
        candidates = local[near].astype(np.float32)
        distance = self._scene.compute_signed_distance(candidates, nsamples=3).numpy()
        return int(np.count_nonzero(distance <= reach))
