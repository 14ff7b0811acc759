"""A picture of every step of the first frame (`--save-steps`), to see where it goes wrong."""

from pathlib import Path
from typing import Any

import numpy as np

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.frames import RawFrame
from doughdata.recordings.workspace import LabelledFrame, Workspace
from doughdata.registry import require_package
from doughschemas import SEGMENT_COMPONENT, SEGMENT_TABLE

__all__ = ["save_steps"]

NAME = "steps.png"
COLUMNS = 4


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
        axes.imshow(image, **options)
    _top_view(figure.add_subplot(rows, COLUMNS, len(panels) + 1), labelled)
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
    depth = np.ma.masked_invalid(np.where(frame.depth > 0, frame.depth, np.nan))
    low, high = config.height_min * 1e3, config.height_max * 1e3
    band = {"cmap": "RdBu_r", "vmin": -high, "vmax": high}
    inliers = np.zeros(labelled.candidates.shape, bool)
    inliers[labelled.candidates] = labelled.dough.inliers
    pieces = np.where(labelled.segments >= SEGMENT_COMPONENT, labelled.segments, 0)
    panels: list[tuple[str, Any, dict[str, Any]]] = []
    if frame.color is not None:
        panels.append(("1 colour", frame.color, {}))
    panels += [
        ("2 depth as recorded", depth, {"cmap": "viridis_r"}),
        ("3 height above the table [mm]", np.ma.masked_invalid(labelled.heights * 1e3), band),
        ("4 table", labelled.segments == SEGMENT_TABLE, grey),
        (f"5 height {low:g} to {high:g} mm", labelled.band, grey),
    ]
    if config.color is not None:
        panels.append(("6 colour range", labelled.coloured, grey))
    panels += [
        (f"7 without {(~labelled.dough.inliers).sum()} outliers", inliers, grey),
        (
            f"8 {labelled.dough.num_pieces} piece(s)",
            np.ma.masked_equal(pieces, 0),
            {"cmap": "tab10"},
        ),
    ]
    return panels


def _top_view(axes: Any, labelled: LabelledFrame) -> None:
    """Voxels from above, in the world."""
    voxels = labelled.dough.voxels * 1e3
    axes.scatter(*voxels[:, :2].T, c=labelled.dough.pieces, s=2, cmap="tab10")
    axes.set_aspect("equal")
    axes.axhline(0, color="#888888", linewidth=0.5)
    axes.axvline(0, color="#888888", linewidth=0.5)
    axes.set_title(f"9 {len(voxels)} voxels from above, world x and y [mm]", fontsize=8)
    axes.tick_params(labelsize=6)
