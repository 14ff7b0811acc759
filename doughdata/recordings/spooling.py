"""Frames, processed one after the other, go to files: nothing but the current one is in memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, UInt16

from doughdata.dataset.spool import RowSpool, SpooledArray
from doughdata.recordings.dough import check_expected
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.frames import RawFrame
from doughdata.recordings.protocol import Loss
from doughdata.recordings.request import Request
from doughdata.recordings.table import Plane
from doughdata.recordings.units import DepthUnits, DepthUnitsError, choose_units
from doughdata.recordings.workspace import LabelledFrame, Workspace, set_up
from doughschemas import Intrinsics

__all__ = ["Frames", "SpooledImages", "spool_frames"]


@runtime_checkable
class Frames(Protocol):
    """Gives frames by time, any number of times."""

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the camera."""
        ...

    @property
    def total(self) -> int:
        """Frames at most."""
        ...

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Frames that could not be decoded in the last run."""
        ...

    def __iter__(self) -> Iterator[RawFrame]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SpooledImages:
    """All frames, on disk, and what they were found to show."""

    depth: SpooledArray
    segments: SpooledArray
    color: SpooledArray | None
    stamps: tuple[int, ...]  # [ns]
    workspace: Workspace
    warnings: tuple[str, ...]  # lines for the user


def spool_frames(
    request: Request, reader: Frames, folder: Path, *, plane: Plane | None = None
) -> SpooledImages:
    """Write all frames to files; once more with coarser depth if a value does not fit.

    Args:
        request: what is converted, and how.
        reader: gives the frames.
        folder: for the files.
        plane: the table, where it is known; None = the largest plane of the first frame.

    Raises:
        RecordingError: no frame can be used, no table, no dough.
    """
    try:
        return _spool(request, reader, folder, plane, fine=True)
    except DepthUnitsError:
        return _spool(request, reader, folder, plane, fine=False)


def _spool(
    request: Request, reader: Frames, folder: Path, plane: Plane | None, *, fine: bool
) -> SpooledImages:
    units: DepthUnits | None = None
    workspace: Workspace | None = None
    stamps: list[int] = []
    beyond = 0
    axes = ("view", "y", "x")
    with (
        RowSpool(folder / "depth", dtype=np.dtype(np.uint16), axes=axes) as depth,
        RowSpool(folder / "segments", dtype=np.dtype(np.uint8), axes=axes) as segments,
        RowSpool(folder / "color", dtype=np.dtype(np.uint8), axes=(*axes, "rgb")) as color,
    ):
        for frame in reader:
            if units is None:
                units = choose_units(frame, request.topics.depth_scale, fine=fine)
            stored = units.stored(frame)
            beyond += units.beyond(frame)
            _check_depth(frame, stored, units)
            metres = units.metres(stored)
            if workspace is None:
                workspace = _workspace(request, reader, frame, metres, plane)
            labelled = workspace.label(metres, frame.color)
            if not stamps:
                check_expected(labelled.dough, request.processing.expect)
                _save_steps(request, frame, workspace, labelled)
            depth.add(stored)
            segments.add(labelled.segments)
            if frame.color is not None:
                color.add(frame.color)
            stamps.append(frame.stamp)
            request.on_progress("converting", len(stamps), reader.total)
        if units is None or workspace is None:
            reasons = "; ".join(str(loss) for loss in reader.losses)
            raise RecordingError(f"{request.path}: no frame can be used: {reasons}")
        return SpooledImages(
            depth=depth.finish(attributes={"depth_unit": units.unit}),
            segments=segments.finish(),
            color=color.finish() if len(color) else None,
            stamps=tuple(stamps),
            workspace=workspace,
            warnings=(*_notes(units, beyond), *workspace.warnings()),
        )


def _check_depth(
    frame: RawFrame, stored: UInt16[np.ndarray, "rows columns"], units: DepthUnits
) -> None:
    """Refuse a frame with depth of which nothing can be stored."""
    if not stored.any():
        with np.errstate(invalid="ignore"):
            least = float(frame.depth[frame.depth > 0].min()) * units.scale
        raise RecordingError(
            f"no depth lies between {units.unit:g} and {65535 * units.unit:g} m, the nearest is "
            f"{least:g} m: --depth-scale says how many metres a unit is (0.001 for millimetres)"
        )


def _notes(units: DepthUnits, beyond: int) -> Iterator[str]:
    if units.guessed:
        yield (
            "the recording does not say in which unit depth is: millimetres were taken "
            "(--depth-scale says otherwise)"
        )
    if beyond:
        yield f"{beyond} pixels are beyond {65535 * units.unit:g} m and were taken as invalid"


def _save_steps(
    request: Request, frame: RawFrame, workspace: Workspace, labelled: LabelledFrame
) -> None:
    if request.save_steps is not None:
        from doughdata.recordings.sheet import save_steps

        save_steps(request.save_steps, frame, workspace, labelled)


def _workspace(
    request: Request,
    reader: Frames,
    frame: RawFrame,
    metres: Float64[np.ndarray, "rows columns"],
    plane: Plane | None,
) -> Workspace:
    return set_up(metres, frame.color, reader.intrinsics, request.processing, plane=plane)
