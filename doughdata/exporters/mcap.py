"""MCAP with Foxglove's schemas: a scene, simulated or recorded, to look at in Foxglove or Rerun.

Topics: `/tf`, `/dough/points`, `/dough/meshes`, `/gripper/meshes`, `/gripper/opening`, and for each
view `/camera/calibration`, `/camera/depth`, `/camera/color` (further views: `/camera_1/...`). What
was not made is left out. `doughdata convert` reads the cameras back.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from doughdata.dataset import Dataset, Frame
from doughdata.dataset.commits import RECORDED
from doughdata.exporters import foxglove
from doughdata.geometry import points_from_depth
from doughdata.registry import require_package
from doughdata.scenes.tools import finger_mesh
from doughdata.view.panels import COLOURS
from doughschemas import (
    SEGMENT_COMPONENT,
    STRAY,
    BadInputError,
    ComponentMesh,
    DepthViews,
    MissingLayerError,
)

__all__ = ["Mcap"]

START = 10**9  # [ns], of the first key frame: a stamp of 0 would mean "not set"
STEEL = np.array([0.36, 0.39, 0.44])
GREY = np.array([0.55, 0.55, 0.55])
Stamped = tuple[str, Any]  # topic and message


class Mcap:
    """Depth, colour, points, meshes, gripper and poses of one scene."""

    def export(
        self,
        dataset: Dataset,
        scenes: Sequence[int],
        out: Path,
        *,
        sensor: str | None = None,
        meshes: bool = True,
    ) -> tuple[Path, ...]:
        """Write one scene.

        Args:
            dataset: with any layers.
            scenes: exactly one scene index.
            out: path that ends in `.mcap`.
            sensor: depth layer; by default the first one that the scene has.
            meshes: whether to write meshes, which are the bulk of a simulated scene.

        Raises:
            BadInputError: not one scene, a path that is no `.mcap` or cannot be written.
            MissingLayerError: the scene has no depth of that sensor.
        """
        if len(scenes) != 1:
            raise BadInputError(f"an .mcap holds one scene, got {len(scenes)}: use --scene I")
        if out.suffix.lower() != ".mcap":
            raise BadInputError(f"mcap is written to a path that ends in .mcap, got {out}")
        writer = require_package("mcap_protobuf.writer", extra="mcap").Writer
        temporary = out.with_name(f".tmp-{uuid4().hex}")
        try:
            with temporary.open("wb") as file, writer(file) as recording:
                for stamp, topic, message in _messages(dataset, scenes[0], sensor, meshes=meshes):
                    recording.write_message(topic, message, stamp, stamp)
            temporary.replace(out)
        except OSError as error:
            raise BadInputError(f"cannot write {out}: {error.strerror or error}") from error
        finally:
            temporary.unlink(missing_ok=True)
        return (out,)


def _messages(
    dataset: Dataset, index: int, sensor: str | None, *, meshes: bool
) -> Iterator[tuple[int, str, Any]]:
    """All messages by time: stamp [ns], topic, message."""
    recorded = dataset.base_layer(index) == RECORDED
    sensor = _sensor(dataset, index, sensor)
    shown: set[str] = set()
    for number in range(_length(dataset, index)):
        frame = dataset.frame(scene=index, frame=number)
        stamp = START + round(frame.timestamp * 1e9)
        views = _views(frame, sensor)
        parts = [_cameras(stamp, frame, views, recorded=recorded)]
        if recorded:
            parts.append(_seen_points(stamp, views))
        else:
            parts.append(_simulated(dataset, stamp, frame, shown, meshes=meshes))
        for part in parts:
            for topic, message in part:
                yield stamp, topic, message


def _length(dataset: Dataset, index: int) -> int:
    table = dataset.scenes
    place = table["scene_index"].to_pylist().index(index)
    return int(table["num_frames"][place].as_py())


def _sensor(dataset: Dataset, index: int, wanted: str | None) -> str | None:
    """The sensor whose depth is written; None if the scene has no depth and none was wanted."""
    if wanted is not None:
        dataset.layer(f"depth.{wanted}", index)  # raises if it is not there
        return wanted
    for layer in dataset.layers:
        if layer.startswith("depth."):
            with suppress(MissingLayerError):
                dataset.layer(layer, index)
                return layer.partition(".")[2]
    return None


def _views(frame: Frame, sensor: str | None) -> DepthViews | None:
    """Views of a key frame; simulated scenes are rendered at some of them only."""
    if sensor is None:
        return None
    try:
        return frame.depth(sensor)
    except MissingLayerError:
        return None


def _cameras(
    stamp: int, frame: Frame, views: DepthViews | None, *, recorded: bool
) -> Iterator[Stamped]:
    if views is None:
        return
    colors = frame.color() if recorded else None
    for row, camera in enumerate(views.cameras):
        number = int(views.view_index[row])
        name = "camera" if number == 0 else f"camera_{number}"
        yield "/tf", foxglove.transforms(stamp, {name: (camera.position, camera.quaternion)})
        yield f"/{name}/calibration", foxglove.calibration(stamp, name, camera.intrinsics)
        image = foxglove.depth_image(stamp, name, views.depth[row], views.depth_unit)
        yield f"/{name}/depth", image
        if colors is not None:
            yield f"/{name}/color", foxglove.color_image(stamp, name, colors[row])


def _seen_points(stamp: int, views: DepthViews | None) -> Iterator[Stamped]:
    """Dough pixels of a recording, as points."""
    if views is None:
        return
    mask = (views.segments[0] >= SEGMENT_COMPONENT) & (views.depth[0] > 0)
    points = points_from_depth(views.depth[0] * views.depth_unit, views.cameras[0], mask)
    labels = (views.segments[0][mask] - SEGMENT_COMPONENT).astype(np.uint8)
    yield "/dough/points", _cloud(stamp, points, labels)


def _simulated(
    dataset: Dataset, stamp: int, frame: Frame, shown: set[str], *, meshes: bool
) -> Iterator[Stamped]:
    """Particles, meshes and the gripper of a simulated key frame."""
    particles = frame.particles
    try:
        topology = frame.topology
    except MissingLayerError:
        topology = None
    labels = particles.object_ids if topology is None else topology.labels
    yield "/dough/points", _cloud(stamp, particles.positions, labels)
    yield from _gripper(dataset, stamp, frame)
    if not meshes or topology is None:
        return
    with suppress(MissingLayerError):
        entities = [
            foxglove.entity(
                stamp,
                "world",
                f"component {k}",
                mesh,
                COLOURS[k % len(COLOURS)],
                metadata={"genus": str(genus)},
            )
            for k, (mesh, genus) in enumerate(zip(frame.meshes, topology.genus, strict=True))
        ]
        names = {entity.id for entity in entities}
        gone = sorted(shown - names)
        shown.clear()
        shown.update(names)
        yield "/dough/meshes", foxglove.scene_update(stamp, entities, gone)


def _gripper(dataset: Dataset, stamp: int, frame: Frame) -> Iterator[Stamped]:
    tools = frame.tools
    poses = {
        f"finger_{k}": (tools.position[k], tools.quaternion[k]) for k in range(len(tools.position))
    }
    yield "/tf", foxglove.transforms(stamp, poses)
    yield "/gripper/opening", foxglove.joint(stamp, "opening", tools.opening)
    before = None
    if frame.frame_index:
        before = dataset.frame(scene=frame.scene_index, frame=frame.frame_index - 1).tools.tool
    if tools.tool != before:  # an entity stays in its frame, which moves
        body = finger_mesh(tools.tool)
        mesh = ComponentMesh(
            vertices=np.asarray(body.vertices, np.float32),
            faces=np.asarray(body.faces, np.uint32),
        )
        fingers = [foxglove.entity(stamp, name, name, mesh, STEEL) for name in poses]
        yield "/gripper/meshes", foxglove.scene_update(stamp, fingers)


def _cloud(stamp: int, points: np.ndarray, labels: np.ndarray) -> Any:
    """Points in the colours of their components; crumbs are grey."""
    colors = np.where((labels == STRAY)[:, None], GREY, COLOURS[labels % len(COLOURS)])
    return foxglove.point_cloud(
        stamp,
        points.astype(np.float32),
        np.rint(colors * 255).astype(np.uint8),
        labels.astype(np.uint8),
    )
