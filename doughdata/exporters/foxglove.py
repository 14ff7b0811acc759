"""Records as messages of Foxglove's schemas (Protobuf), which Foxglove and Rerun open."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16

from doughdata.registry import require_package
from doughschemas import ComponentMesh, Intrinsics

__all__ = [
    "calibration",
    "color_image",
    "depth_image",
    "entity",
    "joint",
    "point_cloud",
    "scene_update",
    "transforms",
]

SECOND = 10**9
FLOAT32, UINT8 = 7, 1  # foxglove.PackedElementField.NumericType


def message(name: str, stamp: int | None = None, /, **fields: Any) -> Any:
    """A message of type `foxglove.<name>`, with its time [ns]."""
    require_package("foxglove_schemas_protobuf", extra="mcap")
    module = import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    made = getattr(module, name)(**fields)
    if stamp is not None:
        made.timestamp.seconds, made.timestamp.nanos = divmod(stamp, SECOND)
    return made


def calibration(stamp: int, frame: str, k: Intrinsics) -> Any:
    """foxglove.CameraCalibration of a pinhole camera."""
    return message(
        "CameraCalibration",
        stamp,
        frame_id=frame,
        width=k.width,
        height=k.height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def depth_image(
    stamp: int, frame: str, depth: UInt16[np.ndarray, "rows columns"], unit: float
) -> Any:
    """foxglove.RawImage in float metres, which holds 0.1 mm steps; NaN where depth is invalid."""
    metres = np.where(depth > 0, depth * unit, np.nan).astype("<f4")
    return _image(stamp, frame, metres, "32FC1")


def color_image(stamp: int, frame: str, color: UInt8[np.ndarray, "rows columns 3"]) -> Any:
    """foxglove.RawImage of RGB pixels."""
    return _image(stamp, frame, color, "rgb8")


def _image(stamp: int, frame: str, pixels: np.ndarray, encoding: str) -> Any:
    return message(
        "RawImage",
        stamp,
        frame_id=frame,
        width=pixels.shape[1],
        height=pixels.shape[0],
        encoding=encoding,
        step=pixels[0].nbytes,
        data=np.ascontiguousarray(pixels).tobytes(),
    )


def point_cloud(
    stamp: int,
    points: Float32[np.ndarray, "points 3"],
    colors: UInt8[np.ndarray, "points 3"],
    labels: UInt8[np.ndarray, " points"],
) -> Any:
    """foxglove.PointCloud in the frame `world`: position [m], colour, component."""
    layout = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4), ("component", "u1")])
    data = np.zeros(len(points), layout)
    data["xyz"], data["component"] = points, labels
    data["rgba"][:, :3], data["rgba"][:, 3] = colors, 255
    names = (("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32))
    names += (("red", 12, UINT8), ("green", 13, UINT8), ("blue", 14, UINT8))
    names += (("alpha", 15, UINT8), ("component", 16, UINT8))
    fields = [message("PackedElementField", name=n, offset=o, type=t) for n, o, t in names]
    cloud = message(
        "PointCloud",
        stamp,
        frame_id="world",
        point_stride=layout.itemsize,
        fields=fields,
        data=data.tobytes(),
    )
    cloud.pose.orientation.w = 1.0
    return cloud


def entity(
    stamp: int,
    frame: str,
    name: str,
    mesh: ComponentMesh,
    color: Float[np.ndarray, " 3"],
    *,
    metadata: Mapping[str, str] | None = None,
) -> Any:
    """foxglove.SceneEntity: one mesh [m] of one colour (RGB in 0..1)."""
    made = message("SceneEntity", stamp, frame_id=frame, id=name, frame_locked=True)
    triangles = made.triangles.add()
    triangles.pose.orientation.w = 1.0
    for x, y, z in mesh.vertices.tolist():
        triangles.points.add(x=x, y=y, z=z)
    triangles.indices.extend(mesh.faces.reshape(-1).tolist())
    red, green, blue = (float(value) for value in color)
    triangles.color.r, triangles.color.g, triangles.color.b = red, green, blue
    triangles.color.a = 1.0
    for key, value in (metadata or {}).items():
        made.metadata.add(key=key, value=value)
    return made


def scene_update(stamp: int, entities: Sequence[Any], gone: Sequence[str] = ()) -> Any:
    """foxglove.SceneUpdate that shows these entities; entities named in `gone` go."""
    update = message("SceneUpdate", entities=list(entities))
    for name in gone:
        deletion = update.deletions.add(id=name)  # type 0: the entity of that id
        deletion.timestamp.seconds, deletion.timestamp.nanos = divmod(stamp, SECOND)
    return update


def transforms(stamp: int, poses: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> Any:
    """foxglove.FrameTransforms: frame -> its position [m] and quaternion (xyzw) in `world`."""
    update = message("FrameTransforms")
    for child, (position, quaternion) in poses.items():
        entry = update.transforms.add(parent_frame_id="world", child_frame_id=child)
        entry.timestamp.seconds, entry.timestamp.nanos = divmod(stamp, SECOND)
        x, y, z = (float(v) for v in position)
        entry.translation.x, entry.translation.y, entry.translation.z = x, y, z
        x, y, z, w = (float(v) for v in quaternion)
        entry.rotation.x, entry.rotation.y, entry.rotation.z = x, y, z
        entry.rotation.w = w
    return update


def joint(stamp: int, name: str, position: float) -> Any:
    """foxglove.JointStates of one joint [m]."""
    made = message("JointStates", stamp)
    made.joints.add(name=name, position=position)
    return made
