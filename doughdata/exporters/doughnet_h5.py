"""The `data.h5` of DoughNet's authors (github dornik/doughnet), for their loader and network.

One dataset a quantity, (scenes, frames, ...), in units of 0.2 m. A mesh is a list of triangles of
fixed length, three vertices each; shorter ones end in triangles without area. Component k has the
label k + 1, because 0 was the gripper; `genus[label]` is -1 where there is no component.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int32

from doughdata.dataset import Dataset, Frame
from doughdata.exporters.folders import new_file
from doughdata.geometry import quaternion_to_matrix
from doughdata.registry import require_package
from doughdata.scenes import finger_mesh
from doughdata.seeds import seed_sequence
from doughschemas import BadInputError

__all__ = ["METRES_PER_UNIT", "DoughnetH5"]

METRES_PER_UNIT = 0.2
PARTS = 5  # length of `genus`: the gripper and four components
FINGER_FACES = 64  # of both fingers together, at least
FINGER_POINTS = 1024
OBSERVED_HEIGHT = 0.15  # [units]: as high as their network sees fingers


class DoughnetH5:
    """Meshes with labels and genus, and the fingers, of all key frames."""

    def export(
        self, dataset: Dataset, scenes: Sequence[int], out: Path, *, faces: int | None = None
    ) -> tuple[Path, ...]:
        """Write scenes into one file.

        Args:
            dataset: with the layer `mesh`.
            scenes: scene indices.
            out: path that ends in `.h5`.
            faces: triangles a key frame; by default as many as the largest has, so that every
                mesh comes through as it is.

        Raises:
            BadInputError: no scene, a wrong path, more than four components, or more triangles
                than `faces`.
            MissingLayerError: a scene has no meshes.
            MissingPackageError: h5py is not installed.
        """
        if out.suffix.lower() not in (".h5", ".hdf5"):
            raise BadInputError(f"doughnet-h5 is written to a path that ends in .h5, got {out}")
        if not len(scenes):
            raise BadInputError("there is no scene to export")
        h5py = require_package("h5py", extra="h5")
        most = max(_most_faces(dataset, scene) for scene in scenes)
        if faces is not None and faces < most:
            raise BadInputError(f"a key frame has {most} triangles, more than faces={faces}")
        shape = (len(scenes), dataset.num_frames)
        finger_faces = max(FINGER_FACES, 2 * max(_tool_faces(dataset, scene) for scene in scenes))
        with new_file(out) as path, h5py.File(path, "w") as file:
            for k, scene in enumerate(scenes):
                tools = [_triangles_of(finger_mesh(t)) for t in dataset.scene(scene).tools]
                for key in range(dataset.num_frames):
                    frame = dataset.frame(scene=scene, frame=key)
                    item = {"scene": np.int32(scene), "frame": np.int32(key)}
                    item |= _dough(frame, most if faces is None else faces)
                    tool = tools[dataset.scene(scene).actions[frame.tools.action].tool]
                    item |= _fingers(frame, tool, finger_faces)
                    for name, value in item.items():
                        _target(file, name, value, shape)[k, key] = value
        return (out,)


def _target(file: Any, name: str, value: Any, shape: tuple[int, int]) -> Any:
    """The dataset of a quantity, made when it is first needed; one chunk a key frame."""
    value = np.asarray(value)
    if name in file:
        return file[name]
    full = (*shape, *value.shape)
    if value.ndim == 0:
        return file.create_dataset(name, full, value.dtype)
    return file.create_dataset(
        name, full, value.dtype, chunks=(1, 1, *value.shape), compression="gzip", shuffle=True
    )


def _most_faces(dataset: Dataset, scene: int) -> int:
    """Triangles of the largest key frame of a scene."""
    layer = dataset.layer("mesh", scene)
    start = layer.rows.start(scene)
    return int(layer.array("face_offsets").rows(start, start + dataset.num_frames)[:, -1].max())


def _tool_faces(dataset: Dataset, scene: int) -> int:
    """Triangles of the largest finger of a scene."""
    return max(len(finger_mesh(tool).faces) for tool in dataset.scene(scene).tools)


def _dough(frame: Frame, length: int) -> dict[str, np.ndarray]:
    """Meshes, labels and genus of a key frame."""
    if len(frame.meshes) >= PARTS:
        raise BadInputError(
            f"{frame}: this format holds {PARTS - 1} components, got {len(frame.meshes)}"
        )
    corners = [mesh.vertices[mesh.faces].reshape(-1, 3) for mesh in frame.meshes]
    labels = np.repeat(np.arange(1, 1 + len(corners)), [len(c) // 3 for c in corners])
    missing = length - len(labels)
    labels = np.pad(labels, (0, missing), constant_values=1).astype(np.int32)
    genus = np.full(PARTS, -1, np.int32)
    genus[1 : 1 + len(frame.topology.genus)] = frame.topology.genus
    return {
        "obj_verts": _padded(np.concatenate([*corners, np.zeros((0, 3), np.float32)]), length),
        "obj_faces": _consecutive(length),
        "obj_vert_labels": np.repeat(labels, 3)[:, None],
        "obj_face_labels": labels[:, None],
        "genus": genus,
    }


def _fingers(frame: Frame, finger: np.ndarray, length: int) -> dict[str, np.ndarray]:
    """Both fingers as one mesh, and points on them as the network observes them."""
    tools = frame.tools
    rotation = quaternion_to_matrix(tools.quaternion)
    # Cut to the observed height by scaling along z, as the authors do.
    low = finger * [1.0, 1.0, OBSERVED_HEIGHT * METRES_PER_UNIT / finger[:, 2].max()]
    key = (frame.scene_index, frame.frame_index)
    rng = np.random.default_rng(seed_sequence(0, "doughnet-h5", *key))
    points = [_sample(low, FINGER_POINTS // 2, rng) for _ in range(2)]
    posed, seen = (
        np.concatenate([part[k] @ rotation[k].T + tools.position[k] for k in range(2)])
        for part in ((finger, finger), points)
    )
    return {
        "ee_verts": _padded(posed, length),
        "ee_faces": _consecutive(length),
        "ee_observed": (seen / METRES_PER_UNIT).astype(np.float32),
    }


def _triangles_of(mesh: Any) -> Float64[np.ndarray, "corners 3"]:
    """Three vertices a triangle [m]."""
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)].reshape(-1, 3)


def _padded(corners: np.ndarray, length: int) -> Float32[np.ndarray, "corners 3"]:
    """Corners in the file's units, the first one repeated up to `length` triangles."""
    out = np.empty((3 * length, 3), np.float32)
    out[: len(corners)] = corners / METRES_PER_UNIT
    out[len(corners) :] = out[0] if len(corners) else 0.0
    return out


def _consecutive(length: int) -> Int32[np.ndarray, "faces 3"]:
    return np.arange(3 * length, dtype=np.int32).reshape(-1, 3)


def _sample(
    corners: np.ndarray, count: int, rng: np.random.Generator
) -> Float64[np.ndarray, "points 3"]:
    """Points uniform over the area of triangles."""
    a, b, c = np.moveaxis(corners.reshape(-1, 3, 3), 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
