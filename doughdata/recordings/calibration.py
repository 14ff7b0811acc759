"""The camera of a recording: intrinsics from its calibration messages or from the user."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.recordings.errors import RecordingError, UndecodableError
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pictures import Lens, PictureError, lens_of
from doughdata.recordings.source import Source
from doughdata.recordings.topics import ChosenTopics
from doughdata.registry import require_package
from doughschemas import BadInputError, Intrinsics

__all__ = ["camera_lens", "read_intrinsics"]

ALIGNED = 1.0  # [px]; calibrations that differ by more are of other cameras
PLUMB_BOB = ("", "plumb_bob", "rational_polynomial", "brown_conrady")  # OpenCV's model
FIELDS = ("width", "height", "fx", "fy", "cx", "cy")


def camera_lens(
    source: Source, topics: ChosenTopics, options: TopicOptions
) -> tuple[Intrinsics, list[str]]:
    """Intrinsics of the depth images, and warnings.

    Raises:
        RecordingError: there is no calibration, none that can be used, or that of the colour
            images is another one.
    """
    if options.intrinsics is not None:
        return options.intrinsics, []
    if topics.info is None:
        raise RecordingError(
            f"no camera_info belongs to {topics.depth}; give --intrinsics FILE (JSON with "
            f"{', '.join(FIELDS)}) or --info-topic"
        )
    lenses, problem = _lenses(source, topics.info)
    if not lenses:
        raise RecordingError(
            f"no message of {topics.info} can be used: it {problem}; give --intrinsics FILE"
        )
    _check_aligned(source, topics, lenses[0].intrinsics)
    warnings = []
    others = sum(lens.intrinsics != lenses[0].intrinsics for lens in lenses)
    if others:
        warnings.append(f"{topics.info} changes: {others} messages differ from the first, used")
    bend = _bend(lenses[0])
    if bend is None or bend > 0.1:
        how = "in a way that is not known here" if bend is None else f"by up to {bend:.1f} pixels"
        warnings.append(
            f"{topics.info} says that the lens bends the picture {how}; depth is taken as it is, "
            "without correction"
        )
    return lenses[0].intrinsics, warnings


def _lenses(source: Source, topic: str) -> tuple[list[Lens], str]:
    """All calibrations that can be used, and why the first of the others cannot."""
    found: list[Lens] = []
    problem = ""
    try:
        for message in source.messages([topic]):
            try:
                found.append(lens_of(message))
            except PictureError as error:
                problem = problem or str(error)
    except UndecodableError as error:
        problem = error.reason
    return found, problem


def _check_aligned(source: Source, topics: ChosenTopics, depth: Intrinsics) -> None:
    """Refuse images of one size whose calibrations differ: their pixels do not fit each other."""
    if topics.color_info in (None, topics.info):
        return
    lenses, _ = _lenses(source, topics.color_info or "")
    if not lenses or (lenses[0].intrinsics.width, lenses[0].intrinsics.height) != (
        depth.width,
        depth.height,
    ):  # another size is told when the images are read
        return
    color = lenses[0].intrinsics
    pairs = ((getattr(depth, name), getattr(color, name)) for name in FIELDS[2:])
    off = max(abs(a - b) for a, b in pairs)
    if off > ALIGNED:
        raise RecordingError(
            f"{topics.depth} and {topics.color} are not aligned: {topics.info} and "
            f"{topics.color_info} differ by up to {off:.1f} pixels; record depth aligned to colour "
            "(aligned_depth_to_color), or leave colour out with --color-topic none"
        )


def _bend(lens: Lens) -> float | None:
    """Largest displacement by distortion along the picture's edge [px]; None if not known."""
    if not any(lens.distortion):
        return 0.0
    if len(lens.distortion) not in (4, 5, 8, 12, 14) or lens.model not in PLUMB_BOB:
        return None
    cv2: Any = require_package("cv2", extra="mcap")
    k = lens.intrinsics
    u, v = np.linspace(0, k.width - 1, 9), np.linspace(0, k.height - 1, 9)
    points = np.array([[x, y] for x in u for y in v])
    rays = (points - [k.cx, k.cy]) / [k.fx, k.fy]
    rays = np.column_stack([rays, np.ones(len(rays))])
    matrix = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]])
    with np.errstate(all="ignore"):
        bent, _ = cv2.projectPoints(
            rays, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion)
        )
        bend = float(np.linalg.norm(bent[:, 0] - points, axis=1).max())
    return bend if np.isfinite(bend) else None


def read_intrinsics(path: Path) -> Intrinsics:
    """Intrinsics from a JSON file; they may stand in a field `intrinsics`, as in a camera file.

    Raises:
        BadInputError: no such file, not JSON, or not a camera.
    """
    try:
        data = json.loads(path.read_text())
    except OSError as error:
        raise BadInputError(f"intrinsics file {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise BadInputError(f"intrinsics file {path}: not JSON ({error})") from error
    if isinstance(data, dict) and "intrinsics" in data:
        data = data["intrinsics"]
    good = isinstance(data, dict) and set(FIELDS) <= set(data)
    if not good or not all(_is_number(data[name]) and data[name] > 0 for name in FIELDS[:4]):
        raise BadInputError(f"intrinsics file {path}: must hold {', '.join(FIELDS)}, above 0")
    if not (_is_number(data["cx"]) and _is_number(data["cy"])):
        raise BadInputError(f"intrinsics file {path}: cx and cy must be numbers")
    width, height = (round(data[name]) for name in ("width", "height"))
    return Intrinsics(
        width=width, height=height, **{name: float(data[name]) for name in FIELDS[2:]}
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
