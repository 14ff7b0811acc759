"""The camera of a recording: intrinsics from its calibration messages or from the user."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pictures import Lens, PictureError, lens_of
from doughdata.recordings.source import Source
from doughdata.recordings.topics import ChosenTopics
from doughdata.registry import require_package
from doughschemas import BadInputError, Intrinsics

__all__ = ["camera_lens", "read_intrinsics"]

FIELDS = ("width", "height", "fx", "fy", "cx", "cy")


def camera_lens(
    source: Source, topics: ChosenTopics, options: TopicOptions
) -> tuple[Intrinsics, list[str]]:
    """Intrinsics of the depth images, and warnings.

    Raises:
        RecordingError: there is no calibration, or none that can be used.
    """
    if options.intrinsics is not None:
        return options.intrinsics, []
    if topics.info is None:
        raise RecordingError(
            f"no camera_info belongs to {topics.depth}; give --intrinsics FILE (JSON with "
            f"{', '.join(FIELDS)}) or --info-topic"
        )
    found: Lens | None = None
    others, problem = 0, ""
    for message in source.messages([topics.info]):
        try:
            lens = lens_of(message)
        except PictureError as error:
            problem = problem or str(error)
            continue
        found = found or lens
        others += lens.intrinsics != found.intrinsics
    if found is None:
        raise RecordingError(
            f"no message of {topics.info} can be used: it {problem}; give --intrinsics FILE"
        )
    warnings = []
    if others:
        warnings.append(f"{topics.info} changes: {others} messages differ from the first, used")
    bend = _bend(found)
    if bend > 0.1:
        warnings.append(
            f"{topics.info} says that the lens bends the picture by up to {bend:.1f} pixels; "
            "depth is taken as it is, without correction"
        )
    return found.intrinsics, warnings


def _bend(lens: Lens) -> float:
    """Largest displacement by distortion along the picture's edge [px]; 0 if the model is odd."""
    if not any(lens.distortion) or len(lens.distortion) not in (4, 5, 8, 12, 14):
        return 0.0
    if lens.model in ("equidistant", "fisheye", "kannala_brandt"):
        return float("inf")
    cv2: Any = require_package("cv2", extra="mcap")
    k = lens.intrinsics
    u, v = np.linspace(0, k.width - 1, 9), np.linspace(0, k.height - 1, 9)
    points = np.array([[x, y] for x in u for y in v])
    rays = (points - [k.cx, k.cy]) / [k.fx, k.fy]
    rays = np.column_stack([rays, np.ones(len(rays))])
    matrix = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]])
    bent, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    return float(np.linalg.norm(bent[:, 0] - points, axis=1).max())


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
