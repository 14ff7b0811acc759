"""One scene of the authors' `data.h5`, as records."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.dataset.graphs import mesh_genus, mesh_volume, mesh_watertight
from doughdata.recordings.authors_shapes import (
    Gripper,
    fit_gripper,
    label_grid,
    points_inside,
    schematic_graph,
    welded,
)
from doughdata.registry import require_package
from doughdata.scenes import check_scene, finger_poses
from doughdata.seeds import seed_sequence
from doughschemas import (
    Action,
    BadInputError,
    Body,
    ComponentMesh,
    ComponentMeshes,
    FrameTopology,
    Particles,
    Scene,
    Tool,
    ToolPoses,
    Topology,
)

__all__ = ["LABEL_SPACING", "AuthorsScene"]

METRES_PER_UNIT = 0.2
LABEL_SPACING = 0.002  # [m], of the label grid: theirs is 0.01 units
SPEEDS = (0.001, 0.3)  # [m/s], of fingers


@dataclass(frozen=True, slots=True, kw_only=True)
class AuthorsScene:
    """One scene of the file."""

    group: Any  # of h5py
    row: int
    scene_id: str
    split: str
    step: float  # [s], between key frames

    @property
    def num_frames(self) -> int:
        """Key frames of each scene of its group."""
        return int(self.group["obj_verts"].shape[1])

    def scene(self, folder: Path) -> Scene:
        """What it was made from, as far as the file tells; meshes are written into the folder."""
        trimesh = require_package("trimesh", extra="sim")
        bodies = []
        for k, mesh in enumerate(self.meshes(0)):
            file = folder / f"{self.scene_id}-{k}.glb"
            trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file)
            low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
            x, y = (float(v) for v in (low + high)[:2] / 2)
            shape = {"file": str(file), "scale": 1.0}
            bodies.append(Body(shape="mesh", parameters=shape, position=(x, y)))
        start, end = self.gripper(0), self.gripper(self.num_frames - 1)
        depth, width, height = start.size
        speed = (start.opening - end.opening) / (2 * self.step * (self.num_frames - 1))
        action = Action(
            position=start.middle,
            yaw=start.yaw,
            opening_start=start.opening,
            opening_end=end.opening,
            speed=float(np.clip(speed, *SPEEDS)),
        )
        return check_scene(
            Scene(
                scene_id=self.scene_id,
                family="doughnet-h5",
                split=self.split,
                region="custom",
                bodies=tuple(bodies),
                tools=(Tool(name="finger", depth=depth, width=width, height=height),),
                actions=(action,),
            )
        )

    def record(self, layer: str, points: int) -> Any:
        """The record of one layer."""
        if layer == "mesh":
            return [
                ComponentMeshes(meshes=meshes, label_grid=label_grid(meshes, LABEL_SPACING))
                for meshes in map(self.meshes, range(self.num_frames))
            ]
        drawn = [self._drawn(frame, points) for frame in range(self.num_frames)]
        if layer == "topology":
            return self._topology(drawn)
        volume = sum(
            mesh_volume(mesh.vertices, mesh.faces) for mesh in self.meshes(self.num_frames - 1)
        )
        return Particles(
            positions=np.stack([positions for positions, _ in drawn]),
            object_ids=np.zeros(points, np.uint8),
            timestamps=np.arange(self.num_frames) * self.step,
            tool_poses=self._tool_poses(),
            spacing=float(np.cbrt(volume / points)),
        )

    def meshes(self, frame: int) -> tuple[ComponentMesh, ...]:
        """Meshes [m] of a key frame, by label.

        Raises:
            BadInputError: one is not closed.
        """
        corners = np.asarray(self.group["obj_verts"][self.row, frame], np.float64)
        corners = (corners * METRES_PER_UNIT).astype(np.float32).reshape(-1, 3, 3)
        labels = np.asarray(self.group["obj_face_labels"][self.row, frame]).ravel()
        meshes = [welded(corners[labels == k].reshape(-1, 3)) for k in np.unique(labels)]
        if not all(mesh_watertight(mesh.faces, len(mesh.vertices)) for mesh in meshes):
            raise BadInputError(f"key frame {frame}: a mesh is not closed")
        return tuple(meshes)

    def genus(self, frame: int) -> tuple[int, ...]:
        """Of each component: what the file says, else what its mesh has."""
        meshes = self.meshes(frame)
        if "genus" not in self.group:
            return tuple(mesh_genus(mesh.faces) for mesh in meshes)
        stored = np.asarray(self.group["genus"][self.row, frame])
        labels = np.unique(self.group["obj_face_labels"][self.row, frame])
        told = [int(stored[k]) if k < len(stored) else -1 for k in labels]
        return tuple(
            mesh_genus(mesh.faces) if genus < 0 else genus
            for genus, mesh in zip(told, meshes, strict=True)
        )

    def gripper(self, frame: int) -> Gripper:
        """The fingers of a key frame as boxes [m]."""
        corners = np.asarray(self.group["ee_verts"][self.row, frame], np.float64)
        return fit_gripper(corners * METRES_PER_UNIT)

    def _drawn(self, frame: int, points: int) -> tuple[np.ndarray, np.ndarray]:
        """The same points for every layer that asks."""
        rng = np.random.default_rng(seed_sequence(0, self.scene_id, frame, "points"))
        return points_inside(self.meshes(frame), points, rng)

    def _tool_poses(self) -> ToolPoses:
        grippers = [self.gripper(frame) for frame in range(self.num_frames)]
        poses = [finger_poses(Action(position=g.middle, yaw=g.yaw), g.opening) for g in grippers]
        return ToolPoses(
            position=np.stack([position for position, _ in poses]),
            quaternion=np.stack([quaternion for _, quaternion in poses]),
            opening=np.array([g.opening for g in grippers]),
            action=np.zeros(self.num_frames, np.int32),
        )

    def _topology(self, drawn: list[tuple[np.ndarray, np.ndarray]]) -> Topology:
        none = np.zeros((0, 2), np.int32)
        genus = tuple(self.genus(frame) for frame in range(self.num_frames))
        frames = tuple(
            FrameTopology(
                labels=labels,
                genus=own,
                graph=schematic_graph(positions, labels, own),
                contacts=none,
            )
            for (positions, labels), own in zip(drawn, genus, strict=True)
        )
        return Topology(
            frames=frames,
            events=(),
            static_num_components=np.array([len(own) for own in genus], np.int32),
            static_genus=genus,
            bonds_made=(none,) * len(frames),
            bonds_broken=(none,) * len(frames),
        )
