"""Depth images of dough, fingers and table, by ray casting."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, UInt16

from doughdata.geometry import pixel_rays, quaternion_to_matrix, transform_points
from doughdata.render._open3d import import_open3d
from doughdata.render.cameras import default_camera, jittered
from doughdata.scenes.tools import finger_mesh
from doughdata.seeds import seed_sequence
from doughdata.stages import DepthImage, Sensor
from doughschemas import (
    SEGMENT_COMPONENT,
    SEGMENT_NONE,
    SEGMENT_TABLE,
    SEGMENT_TOOL,
    BadInputError,
    Camera,
    ComponentMesh,
    ComponentMeshes,
    DepthViews,
    Scene,
    ToolPoses,
)

__all__ = ["TRAINING_FRAMES", "DepthRenderer", "DepthStage", "RenderConfig", "quantised"]

TRAINING_FRAMES = tuple(range(5, 66, 5))
TABLE_HALF_SIZE = 2.0  # [m]; a ray that leaves this square hits nothing
# Workers are processes, one a core, so more threads inside one would only fight each other.
THREADS = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderConfig:
    """What is rendered, from where, and how finely depth is stored."""

    camera: Camera = field(default_factory=default_camera)
    views: int = 1  # cameras a scene, each with its own jitter
    position_sigma: float = 0.010  # [m], jitter per axis
    angle_sigma: float = math.radians(1.0)  # [rad], jitter per axis
    frames: tuple[int, ...] | None = TRAINING_FRAMES  # key frames; None = every one
    depth_unit: float = 1e-4  # [m]


class DepthRenderer:
    """Casts one ray a pixel. The scene of a key frame is built once for all its cameras."""

    def render(
        self,
        meshes: Sequence[ComponentMesh],
        fingers: Sequence[ComponentMesh],
        cameras: Sequence[Camera],
    ) -> list[DepthImage]:
        """Ideal images of components, fingers (all in the world [m]) and table, one a camera.

        Component `k` of `meshes` has the segment `SEGMENT_COMPONENT + k`.
        """
        o3d = import_open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
        table = [(SEGMENT_TABLE, _table())]
        tools = [(SEGMENT_TOOL, finger) for finger in fingers]
        dough = [(SEGMENT_COMPONENT + k, mesh) for k, mesh in enumerate(meshes)]
        # Geometry ids count up from 0; the last entry stands for a ray that hits nothing.
        segment_of = []
        for segment, mesh in table + tools + dough:
            if len(mesh.faces):
                vertices = np.ascontiguousarray(mesh.vertices, np.float32)
                scene.add_triangles(vertices, np.ascontiguousarray(mesh.faces, np.uint32))
                segment_of.append(segment)
        lookup = np.array([*segment_of, SEGMENT_NONE], np.uint8)
        rays = o3d.core.Tensor.from_numpy(_rays(cameras))
        hits = scene.cast_rays(rays, nthreads=THREADS)
        distance, geometry = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
        # Rays have z = 1 in the camera, so the distance in units of the ray is the depth.
        depth = np.where(np.isfinite(distance), distance, np.float32(0))
        segments = lookup[np.minimum(geometry, len(segment_of))]
        return _split(depth, segments, cameras)


class DepthStage:
    """Renders each key frame and view once and lets every sensor observe the same ideal image."""

    def __init__(self, config: RenderConfig | None = None) -> None:
        self.config = config or RenderConfig()
        if self.config.views < 1:
            raise BadInputError(f"at least one view is needed, got {self.config.views}")

    def frame_indices(self, num_frames: int) -> tuple[int, ...]:
        """Key frames that are rendered of a scene with `num_frames` of them.

        Raises:
            BadInputError: the scene has none of the configured key frames.
        """
        if self.config.frames is None:
            return tuple(range(num_frames))
        frames = tuple(sorted({frame for frame in self.config.frames if 0 <= frame < num_frames}))
        if not frames:
            raise BadInputError(
                f"no key frame to render: the scene has 0..{num_frames - 1}, wanted "
                f"{', '.join(map(str, self.config.frames))}; --all-frames renders every one"
            )
        return frames

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """The scene's jittered cameras; a view looks the same in every key frame and sensor."""
        c = self.config
        return tuple(
            jittered(
                c.camera,
                _generator(scene, "camera", view),
                position_sigma=c.position_sigma,
                angle_sigma=c.angle_sigma,
            )
            for view in range(c.views)
        )

    def views(
        self,
        scene: Scene,
        tool_poses: ToolPoses,
        meshes: Mapping[int, ComponentMeshes],
        *,
        sensors: Mapping[str, Sensor],
    ) -> dict[str, DepthViews]:
        """Depth of the configured key frames, by sensor name; rows are frame-major.

        `meshes` is asked once for each of `frame_indices(number of key frames)`, in order, so it
        may load them one by one. Noise depends on scene, sensor name, frame and view alone.

        Raises:
            BadInputError: a frame's mesh is missing, there is no frame to render, or a sensor
                returned something else than a depth image.
        """
        cameras = self.cameras(scene)
        frames = self.frame_indices(len(tool_poses.opening))
        depth: dict[str, list[UInt16[np.ndarray, "rows columns"]]] = {name: [] for name in sensors}
        segments, rows = [], []
        for frame, view, image in _images(scene, tool_poses, meshes, frames, cameras):
            rows.append((frame, view))
            segments.append(image.segments)
            for name, sensor in sensors.items():
                rng = _generator(scene, "noise", name, frame, view)
                observed = _observed(name, sensor, image, cameras[view], rng)
                depth[name].append(quantised(observed, self.config.depth_unit))
        return {
            name: DepthViews(
                depth=np.stack(depth[name]),
                segments=np.stack(segments),
                frame_index=np.array([frame for frame, _ in rows], np.int32),
                view_index=np.array([view for _, view in rows], np.int32),
                cameras=tuple(cameras[view] for _, view in rows),
                depth_unit=self.config.depth_unit,
            )
            for name in sensors
        }


def quantised(
    depth: Float[np.ndarray, "rows columns"], unit: float
) -> UInt16[np.ndarray, "rows columns"]:
    """Depth [m] in whole units [m]; what is not in 1..65535 of them (or no number) becomes 0."""
    steps = np.rint(np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0) / unit)
    return np.where((steps >= 1) & (steps <= 65535), steps, 0).astype(np.uint16)


def _images(
    scene: Scene,
    tool_poses: ToolPoses,
    meshes: Mapping[int, ComponentMeshes],
    frames: Sequence[int],
    cameras: Sequence[Camera],
) -> Iterator[tuple[int, int, DepthImage]]:
    """Frame, view and ideal image, frame by frame; each frame's scene is built once."""
    renderer = DepthRenderer()
    fingers = [_finger(scene, action) for action in range(len(scene.actions))]
    for frame in frames:
        try:
            components = meshes[frame].meshes
        except KeyError:
            message = f"scene {scene.scene_id}: key frame {frame} has no mesh"
            raise BadInputError(message) from None
        posed = _posed(fingers[int(tool_poses.action[frame])], tool_poses, frame)
        for view, image in enumerate(renderer.render(components, posed, cameras)):
            yield frame, view, image


def _observed(
    name: str, sensor: Sensor, image: DepthImage, camera: Camera, rng: np.random.Generator
) -> Float[np.ndarray, "rows columns"]:
    """What a sensor reports, checked: sensors are plug-ins."""
    # All sensors share the ideal image, so none of them may write into it.
    image.depth.setflags(write=False)
    image.segments.setflags(write=False)
    observed = np.asarray(sensor.observe(image, camera, rng=rng))
    if observed.shape != image.depth.shape or observed.dtype.kind != "f":
        raise BadInputError(
            f"sensor {name!r} must return floats of shape {image.depth.shape}, "
            f"got {observed.dtype} of shape {observed.shape}"
        )
    return observed


def _generator(scene: Scene, *key: str | int) -> np.random.Generator:
    return np.random.default_rng(seed_sequence(scene.seed, scene.scene_id, *key))


def _rays(cameras: Sequence[Camera]) -> Float32[np.ndarray, "pixels 6"]:
    """Origin and direction in the world, one ray a pixel, row-major, camera after camera."""
    shapes = [(camera.intrinsics.height, camera.intrinsics.width) for camera in cameras]
    rays = np.empty((sum(rows * columns for rows, columns in shapes), 6), np.float32)
    start = 0
    for camera, (rows, columns) in zip(cameras, shapes, strict=True):
        part = rays[start : start + rows * columns].reshape(rows, columns, 6)
        part[..., :3] = camera.position
        pixels = pixel_rays(camera.intrinsics)
        across, down = pixels[0, :, 0], pixels[:, 0, 1]
        # A ray is (x of its column, y of its row, 1), so only sums are left for every pixel.
        for axis, (x, y, z) in enumerate(quaternion_to_matrix(np.array(camera.quaternion))):
            column, row = (across * x).astype(np.float32), (down * y + z).astype(np.float32)
            np.add(column, row[:, None], out=part[..., 3 + axis])
        start += rows * columns
    return rays


def _split(depth: np.ndarray, segments: np.ndarray, cameras: Sequence[Camera]) -> list[DepthImage]:
    images, start = [], 0
    for camera in cameras:
        shape = (camera.intrinsics.height, camera.intrinsics.width)
        part = slice(start, start + shape[0] * shape[1])
        images.append(
            DepthImage(depth=depth[part].reshape(shape), segments=segments[part].reshape(shape))
        )
        start = part.stop
    return images


def _table() -> ComponentMesh:
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    return ComponentMesh(
        vertices=np.array(corners, np.float32) * np.float32(TABLE_HALF_SIZE),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
    )


def _finger(scene: Scene, action: int) -> ComponentMesh:
    mesh = finger_mesh(scene.tools[scene.actions[action].tool])
    return ComponentMesh(
        vertices=np.asarray(mesh.vertices, np.float32), faces=np.asarray(mesh.faces, np.uint32)
    )


def _posed(finger: ComponentMesh, poses: ToolPoses, frame: int) -> list[ComponentMesh]:
    return [
        ComponentMesh(
            vertices=transform_points(finger.vertices, position, quaternion).astype(np.float32),
            faces=finger.faces,
        )
        for position, quaternion in zip(poses.position[frame], poses.quaternion[frame], strict=True)
    ]
