"""Key frames as rows for tabular formats: state of the gripper, topology, images of each sensor."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8, UInt16

from doughdata.dataset import Dataset
from doughdata.registry import require_package
from doughschemas import BadInputError, Camera, DepthViews, MissingLayerError

__all__ = [
    "STATE_NAMES",
    "Image",
    "chosen_sensors",
    "image_names",
    "png",
    "rows_of",
    "scene_images",
    "scene_splits",
    "scene_states",
]

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
STATE_NAMES = ("opening", *(f"finger{k}_{name}" for k in range(2) for name in POSE))


@dataclass(frozen=True, slots=True, kw_only=True)
class Image:
    """One view of one key frame."""

    depth: UInt16[np.ndarray, "rows columns"]  # in units of `depth_unit`, 0 = invalid
    segments: UInt8[np.ndarray, "rows columns"]  # SEGMENT_*
    camera: Camera
    depth_unit: float  # [m]


def scene_states(dataset: Dataset, scene: int) -> dict[int, Float64[np.ndarray, " 15"]]:
    """Key frame -> opening [m], position [m] and quaternion (xyzw) of both fingers; `STATE_NAMES`.

    Key frames in which a recording does not know both fingers are left out.
    """
    poses: dict[int, list[dict[str, Any]]] = {}
    for row in rows_of(dataset, "tool_poses", scene):
        poses.setdefault(row["frame_index"], []).append(row)
    return {
        frame: np.array([both[0]["opening"], *(v for p in both for v in _pose(p))], np.float64)
        for frame, both in poses.items()
        if len(both) == 2 and both[0]["opening"] is not None
    }


def _pose(row: Mapping[str, Any]) -> list[float]:
    return [*row["position"], *row["quaternion"]]


def chosen_sensors(dataset: Dataset, wanted: str | None) -> list[str]:
    """Sensors to export: those that are named (comma-separated), or all that there are.

    Raises:
        MissingLayerError: a sensor that nobody rendered with.
    """
    there = [layer.partition(".")[2] for layer in dataset.layers if layer.startswith("depth.")]
    if wanted is None:
        return there
    names = [name.strip() for name in wanted.split(",") if name.strip()]
    if missing := [name for name in names if name not in there]:
        raise MissingLayerError(
            f"{dataset.uri} has no depth from {missing[0]!r} (it has: {', '.join(there) or 'none'})"
            f"; make it with `doughdata render --noise {missing[0]} --dataset {dataset.uri}`"
        )
    return names


def image_names(
    dataset: Dataset, scenes: Sequence[int], sensors: Sequence[str]
) -> dict[str, list[str]]:
    """Sensor -> names of its images: the sensor, or `<sensor>_<view>` if it has several views."""
    views = dataset.table("views").select(["scene_index", "layer", "view_index"]).to_pylist()
    taken, found = set(scenes), {}
    for sensor in sensors:
        numbers = {
            row["view_index"]
            for row in views
            if row["layer"] == f"depth.{sensor}" and row["scene_index"] in taken
        }
        several = len(numbers) > 1
        found[sensor] = [f"{sensor}_{k}" if several else sensor for k in sorted(numbers)]
    return {sensor: names for sensor, names in found.items() if names}


def scene_images(
    dataset: Dataset, scene: int, images: Mapping[str, Sequence[str]]
) -> dict[int, dict[str, Image]]:
    """Key frame -> name (as in `images`) -> image.

    A sensor that the scene was not rendered with is left out.
    """
    found: dict[int, dict[str, Image]] = {}
    for sensor, names in images.items():
        try:
            views = dataset.read_depth(scene, sensor)
        except MissingLayerError:
            continue
        for frame, view, image in _images(views):
            name = f"{sensor}_{view}" if len(names) > 1 else sensor
            found.setdefault(frame, {})[name] = image
    return found


def scene_splits(dataset: Dataset) -> dict[int, str]:
    """scene_index -> split."""
    names = (dataset.scenes[name].to_pylist() for name in ("scene_index", "split"))
    return dict(zip(*names, strict=True))


def rows_of(dataset: Dataset, table: str, scene: int) -> list[dict[str, Any]]:
    """Rows of a derived table that belong to a scene; their keys are the columns."""
    rows = dataset.table(table)
    start, stop = np.searchsorted(rows["scene_index"].to_numpy(), [scene, scene + 1])
    return rows.slice(start, stop - start).to_pylist()


def png(image: np.ndarray) -> bytes:
    """A PNG of 8 or 16 bits a pixel; without loss.

    Raises:
        MissingPackageError: OpenCV is not installed.
        BadInputError: OpenCV cannot encode the image.
    """
    cv2 = require_package("cv2", extra="render")
    done, data = cv2.imencode(".png", image)
    if not done:
        raise BadInputError(f"an image of shape {image.shape} cannot be written as PNG")
    return data.tobytes()


def _images(views: DepthViews) -> Iterator[tuple[int, int, Image]]:
    for k, (frame, view) in enumerate(zip(views.frame_index, views.view_index, strict=True)):
        image = Image(
            depth=views.depth[k],
            segments=views.segments[k],
            camera=views.cameras[k],
            depth_unit=views.depth_unit,
        )
        yield int(frame), int(view), image
