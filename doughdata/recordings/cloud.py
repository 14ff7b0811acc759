"""Converter `cloud`: a PLY or PCD point cloud of dough on a table, as one scene with one key frame.

A cloud that several cameras saw has no camera. It is seen by a virtual one, straight from above and
from so far that its rays are nearly parallel: each pixel keeps the highest point in it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.dataset.layers import RecordedScene
from doughdata.recordings.cloud_files import read_cloud
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.files import check_readable
from doughdata.recordings.frames import RawFrame
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.recordings.protocol import Conversion, Loss, OnProgress, silent
from doughdata.recordings.request import Request
from doughdata.recordings.spooling import SpooledImages, spool_frames
from doughdata.recordings.table import Plane
from doughdata.recordings.writing import commit_scene, known_scene, origin_of, room_for
from doughschemas import Intrinsics

__all__ = ["Cloud"]

SUFFIXES = (".ply", ".pcd")
PIXEL = 0.00025  # [m], on the table
MARGIN = 0.005  # [m], around the cloud
ABOVE = 1.0  # [m], of the camera above the highest point
MOST_PIXELS = 2048  # a side
LARGEST = 2.0  # [m], extent of a cloud
DEEPEST, HIGHEST = 0.02, 0.1  # [m], its lowest point below and above the table


class Cloud:
    """Point clouds in metres, z up, with the table at z = 0."""

    def takes(self, path: Path) -> bool:
        """A file called .ply or .pcd."""
        return path.is_file() and path.suffix.lower() in SUFFIXES

    def convert(
        self,
        path: Path,
        dataset: str,
        *,
        processing: ProcessingConfig | None = None,
        save_steps: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Conversion:
        """Convert one cloud; see `Converter.convert`.

        The world keeps the cloud's axes and heights; its origin moves under the dough.

        Raises:
            RecordingError: no points, other units or another frame, or no dough.
            DatasetError: the dataset cannot be written.
        """
        check_readable(path)
        request = Request(
            path=path,
            dataset=dataset,
            topics=TopicOptions(),
            processing=processing or ProcessingConfig(),
            save_steps=save_steps,
            on_progress=on_progress or silent,
        )
        room_for(dataset)
        origin = origin_of(self, path, request.options())
        known = known_scene(dataset, origin)
        if known is not None:
            return known
        points, colors, bad = read_cloud(path)
        _checked(path, points)
        frames, plane, hidden = _seen_from_above(points, colors)
        warnings = [f"{hidden} points lie under others and are hidden from above"] * bool(hidden)
        warnings += [f"{bad} points are not finite and were left out"] * bool(bad)
        with TemporaryDirectory(prefix="doughdata-") as folder:
            images = spool_frames(request, frames, Path(folder), plane=plane)
            warnings += images.warnings
            figures = {"frames": 1, "points": frames.points, "hidden": hidden}
            figures |= images.workspace.figures()
            parameters = {
                **origin,
                "figures": figures,
                "losses": [],
                "warnings": warnings,
            }
            record = _record(path, images, parameters)
            index = commit_scene(dataset, record)
        return Conversion(
            dataset=dataset, scenes=(index,), frames=1, warnings=tuple(warnings), figures=figures
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _OneFrame:
    """The only frame."""

    frame: RawFrame
    intrinsics: Intrinsics
    points: int
    total: int = 1
    losses: tuple[Loss, ...] = ()

    def __iter__(self) -> Iterator[RawFrame]:
        yield self.frame


def _checked(path: Path, points: Float64[np.ndarray, "points 3"]) -> None:
    """Refuse clouds in other units or another frame."""
    with np.errstate(over="ignore"):
        low, high = points.min(axis=0), points.max(axis=0)
        extent = float((high - low).max())
    if extent > LARGEST:
        mm = 10 * LARGEST < extent <= 1e3 * LARGEST
        guess = " (in millimetres? divide by 1000)" if mm else ""
        raise RecordingError(
            f"{path}: the cloud is {extent:.3g} wide; it must be in metres{guess}, cropped to the "
            "workspace"
        )
    if not -DEEPEST <= low[2] <= HIGHEST:
        raise RecordingError(
            f"{path}: its lowest point is at z = {low[2]:.3g}; z must point up and the table be at "
            "z = 0"
        )


def _seen_from_above(
    points: Float64[np.ndarray, "points 3"], colors: UInt8[np.ndarray, "points 3"] | None
) -> tuple[_OneFrame, Plane, int]:
    """Image of a cloud; the table in it; how many points are hidden below others.

    The picture's left is the cloud's x and its down the cloud's y, so that the world, whose x is
    the picture's left, has the cloud's axes.
    """
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    middle, height = (low + high) / 2, high[2] + ABOVE
    extent = float((high - low)[:2].max()) * height / ABOVE  # the highest points spread most
    size = min(int(np.ceil(extent / PIXEL)) + 1, MOST_PIXELS)
    focal = height * size / extent
    intrinsics = Intrinsics(
        width=size, height=size, fx=focal, fy=focal, cx=(size - 1) / 2, cy=(size - 1) / 2
    )
    z = height - points[:, 2]
    u = np.rint(intrinsics.cx - focal * (points[:, 0] - middle[0]) / z).astype(int)
    v = np.rint(intrinsics.cy + focal * (points[:, 1] - middle[1]) / z).astype(int)
    order = np.argsort(-z, kind="stable")  # the nearest is written last
    depth = np.zeros((size, size), np.float32)
    depth[v[order], u[order]] = z[order]
    color = None
    if colors is not None:
        color = np.zeros((size, size, 3), np.uint8)
        color[v[order], u[order]] = colors[order]
    frame = RawFrame(stamp=0, depth=depth, color=color, encoding="32fc1")
    plane = Plane(normal=np.array([0.0, 0.0, -1.0]), offset=height, share=0.0, residual=0.0)
    hidden = len(points) - int(np.count_nonzero(depth))
    return _OneFrame(frame=frame, intrinsics=intrinsics, points=len(points)), plane, hidden


def _record(path: Path, images: SpooledImages, parameters: dict[str, Any]) -> RecordedScene:
    return RecordedScene(
        scene_id=path.name.partition(".")[0],
        camera=images.workspace.camera,
        timestamps=np.zeros(1),
        depth=images.depth,
        segments=images.segments,
        color=images.color,
        num_bodies=images.workspace.pieces[0],
        opening=np.full(1, np.nan),
        parameters=parameters,
    )
