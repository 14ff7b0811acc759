"""A picture of every step of the first frame (`--save-steps`), to see where it goes wrong."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.frames import RawFrame
from doughdata.recordings.workspace import LabelledFrame, Workspace
from doughdata.registry import require_package
from doughschemas import SEGMENT_COMPONENT, SEGMENT_TABLE

__all__ = ["save_steps"]

NAME = "steps.png"
COLUMNS = 4
SPARSE = 4.0  # [px]; points further apart are drawn as spots, a pixel each would not be seen


def save_steps(
    folder: Path, frame: RawFrame, workspace: Workspace, labelled: LabelledFrame
) -> Path:
    """Save `steps.png` in a folder, which is made if it is not there.

    Raises:
        RecordingError: the folder cannot be written.
        MissingPackageError: matplotlib is not installed.
    """
    figures = require_package("matplotlib.figure", extra="view")
    panels = _panels(frame, workspace, labelled)
    rows = -(-(len(panels) + 1) // COLUMNS)
    figure = figures.Figure(figsize=(COLUMNS * 3.2, rows * 2.75), dpi=110, facecolor="white")
    for place, (title, image, options) in enumerate(panels, start=1):
        axes = figure.add_subplot(rows, COLUMNS, place)
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
        axes.imshow(image, interpolation="nearest", **options)
    last = len(panels) + 1
    _top_view(figure.add_subplot(rows, COLUMNS, last), labelled, last)
    figure.tight_layout()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / NAME)
    except OSError as error:
        raise RecordingError(f"cannot write {folder / NAME}: {error.strerror or error}") from error
    return folder / NAME


def _panels(
    frame: RawFrame, workspace: Workspace, labelled: LabelledFrame
) -> list[tuple[str, Any, dict[str, Any]]]:
    """Title, image and options of each step that is an image."""
    config = workspace.config
    grey = {"cmap": "gray", "vmin": 0, "vmax": 1}
    valid = labelled.heights > -np.inf
    depth = np.where(valid, frame.depth, np.nan)
    low, high = config.height_min * 1e3, config.height_max * 1e3
    band = {"cmap": "RdBu_r", "vmin": -high, "vmax": high}
    inliers = np.zeros(labelled.candidates.shape, bool)
    inliers[labelled.candidates] = labelled.dough.inliers
    pieces = np.where(labelled.segments >= SEGMENT_COMPONENT, labelled.segments, np.nan)
    outliers = int((~labelled.dough.inliers).sum())
    pieces_title = f"{labelled.dough.num_pieces} piece(s)"
    panels: list[tuple[str, Any, dict[str, Any]]] = [
        *[("colour", frame.color, {})] * (frame.color is not None),
        ("depth as recorded", depth, {"cmap": "viridis_r"}),
        ("height above the table [mm]", labelled.heights * 1e3, band),
        ("table", labelled.segments == SEGMENT_TABLE, grey),
        (f"height {low:g} to {high:g} mm", labelled.band, grey),
        *[("colour range", labelled.coloured, grey)] * (config.color is not None),
        (f"without {outliers} outliers", inliers, grey),
        (pieces_title, pieces, {"cmap": "tab10"}),
    ]
    near = _nearest_valid(valid)
    return [
        (f"{number} {title}", image if near is None else image[near], options)
        for number, (title, image, options) in enumerate(panels, start=1)
    ]


def _nearest_valid(valid: Bool[np.ndarray, "rows columns"]) -> tuple[np.ndarray, ...] | None:
    """Where each pixel of a picture of scattered points is taken from; None for a dense one."""
    from scipy.ndimage import distance_transform_edt

    apart = np.sqrt(valid.size / max(int(valid.sum()), 1))  # [px], of points spread evenly
    if apart < SPARSE:
        return None
    found: Any = distance_transform_edt(~valid, return_indices=True)
    distance, nearest = found
    place = np.indices(valid.shape)
    return tuple(np.where(distance <= apart, nearest, place))


def _top_view(axes: Any, labelled: LabelledFrame, number: int) -> None:
    """Voxels from above, in the world."""
    voxels = labelled.dough.voxels * 1e3
    axes.scatter(*voxels[:, :2].T, c=labelled.dough.pieces, s=2, cmap="tab10")
    axes.set_aspect("equal")
    axes.axhline(0, color="#888888", linewidth=0.5)
    axes.axvline(0, color="#888888", linewidth=0.5)
    axes.set_title(f"{number} {len(voxels)} voxels from above, world x and y [mm]", fontsize=8)
    axes.tick_params(labelsize=6)
