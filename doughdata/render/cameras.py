"""Cameras: the paper's set-up, jitter, and cameras from JSON."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.geometry import (
    matrix_to_quaternion,
    quaternion_to_matrix,
    rotation_vector_to_matrix,
)
from doughschemas import BadInputError, Camera, Intrinsics

__all__ = [
    "camera_from_json",
    "camera_to_json",
    "default_camera",
    "jittered",
    "look_at",
    "read_camera",
    "scaled",
]

# The paper's camera (its public configuration): a 1920 x 1080 picture, 0.57 m from the workspace,
# on its +y side, looking down at 46 degrees. The pose maps the optical frame to the world; it was
# checked that world "down" is optical "down" and that the optical axis meets the table 35 mm from
# the origin, so the whole workspace is in the picture. The axes were the metric world already.
PAPER_INTRINSICS = Intrinsics(width=1920, height=1080, fx=1386.89, fy=1385.55, cx=971.77, cy=530.13)
PAPER_POSITION = (0.0589, 0.3974, 0.4026)  # [m]
PAPER_QUATERNION = (0.0319, 0.9258, -0.3766, -0.0102)  # xyzw, length 1.00003


def default_camera() -> Camera:
    """The paper's camera at a third of its resolution: 640 x 360 pixels."""
    return Camera(
        intrinsics=scaled(PAPER_INTRINSICS, 1 / 3),
        position=PAPER_POSITION,
        quaternion=_unit(PAPER_QUATERNION),
    )


def scaled(intrinsics: Intrinsics, factor: float) -> Intrinsics:
    """The same lens on a sensor with `factor` times the pixels along each axis.

    Pixel centres are at whole numbers, so the picture's edge is at -0.5 and stays there:
    u' + 0.5 = factor (u + 0.5).
    """
    return Intrinsics(
        width=round(intrinsics.width * factor),
        height=round(intrinsics.height * factor),
        fx=intrinsics.fx * factor,
        fy=intrinsics.fy * factor,
        cx=(intrinsics.cx + 0.5) * factor - 0.5,
        cy=(intrinsics.cy + 0.5) * factor - 0.5,
    )


def look_at(
    intrinsics: Intrinsics,
    position: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at `position` [m] whose axis meets `target` [m], with the horizon level.

    Straight down, where no horizon is defined, the picture's up is world +y.

    Raises:
        BadInputError: position and target coincide.
    """
    forward = np.subtract(target, position).astype(float)
    length = np.linalg.norm(forward)
    if length < 1e-9:
        raise BadInputError(f"a camera at {position} cannot look at itself")
    forward /= length
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    matrix = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Camera(
        intrinsics=intrinsics,
        position=_triple(position),
        quaternion=_unit(matrix_to_quaternion(matrix)),
    )


def jittered(
    camera: Camera,
    rng: np.random.Generator,
    *,
    position_sigma: float = 0.010,
    angle_sigma: float = math.radians(1.0),
) -> Camera:
    """A camera moved by a normal offset [m] and turned by a normal rotation vector [rad], per axis.

    Defaults are the paper's. The rotation is about the camera's own axes.
    """
    position = np.array(camera.position) + rng.normal(0.0, position_sigma, 3)
    turn = rotation_vector_to_matrix(rng.normal(0.0, angle_sigma, 3))
    matrix = quaternion_to_matrix(np.array(camera.quaternion)) @ turn
    return Camera(
        intrinsics=camera.intrinsics,
        position=_triple(position),
        quaternion=_unit(matrix_to_quaternion(matrix)),
    )


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Plain dictionary of a camera; `camera_from_json` brings it back equal."""
    return {
        "intrinsics": asdict(camera.intrinsics),
        "position": list(camera.position),
        "quaternion": list(camera.quaternion),
    }


def camera_from_json(data: Any, *, name: str = "camera") -> Camera:
    """Build a camera from JSON: `intrinsics`, `position` [m], and `quaternion` or `look_at` [m].

    Raises:
        BadInputError: unknown or missing fields, wrong types, or values no camera has.
    """
    known = {"intrinsics", "position", "quaternion", "look_at"}
    if not isinstance(data, Mapping):
        raise BadInputError(f"{name}: expected a JSON object, got {type(data).__name__}")
    if unknown := sorted(set(data) - known):
        raise BadInputError(f"{name}: unknown field {unknown[0]!r} (known: {sorted(known)})")
    if ("quaternion" in data) == ("look_at" in data):
        raise BadInputError(f"{name}: give either quaternion (xyzw) or look_at, not both")
    intrinsics = _intrinsics(data.get("intrinsics"), name)
    position = _numbers(data.get("position"), 3, f"{name}: position")
    if "look_at" in data:
        return look_at(
            intrinsics, _triple(position), _triple(_numbers(data["look_at"], 3, f"{name}: look_at"))
        )
    quaternion = _numbers(data["quaternion"], 4, f"{name}: quaternion")
    if abs(math.hypot(*quaternion) - 1) > 1e-3:
        raise BadInputError(f"{name}: quaternion must have length 1, got {quaternion}")
    return Camera(intrinsics=intrinsics, position=_triple(position), quaternion=_unit(quaternion))


def read_camera(path: str | Path) -> Camera:
    """A camera from a JSON file.

    Raises:
        BadInputError: no such file, not JSON, or not a camera.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text())
    except OSError as error:
        raise BadInputError(f"camera file {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise BadInputError(f"camera file {path}: not JSON ({error})") from error
    return camera_from_json(data, name=f"camera file {path}")


def _intrinsics(data: Any, name: str) -> Intrinsics:
    known = [field.name for field in fields(Intrinsics)]
    if not isinstance(data, Mapping) or set(data) != set(known):
        raise BadInputError(f"{name}: intrinsics must hold exactly {', '.join(known)}")
    numbers = _numbers([data[key] for key in known], len(known), f"{name}: intrinsics")
    values = dict(zip(known, numbers, strict=True))
    size = (values["width"], values["height"])
    if any(value != int(value) or not 1 <= value <= 16384 for value in size):
        raise BadInputError(f"{name}: width and height must be whole numbers in 1..16384")
    if values["fx"] <= 0 or values["fy"] <= 0:
        raise BadInputError(f"{name}: fx and fy must be positive")
    lens = {key: values[key] for key in ("fx", "fy", "cx", "cy")}
    return Intrinsics(width=int(size[0]), height=int(size[1]), **lens)


def _numbers(data: Any, count: int, what: str) -> list[float]:
    good = isinstance(data, list | tuple) and len(data) == count
    if not good or not all(
        isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        for value in data
    ):
        raise BadInputError(f"{what} must be {count} numbers, got {data!r}")
    return [float(value) for value in data]


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _unit(values: Any) -> tuple[float, float, float, float]:
    """Unit quaternion; one that is unit already stays bit for bit, so JSON round trips."""
    x, y, z, w = (float(value) for value in values)
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if abs(length - 1) < 1e-12:
        return x, y, z, w
    return x / length, y / length, z / length, w / length
