"""Points and colours of PLY and PCD files.

Open3D fills what is missing at the end of a cut file with arbitrary numbers and returns it; so PLY
is read by trimesh, which refuses such files, and the length of a PCD file is checked first.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.recordings.errors import RecordingError
from doughdata.registry import require_package

__all__ = ["read_cloud"]

Points = Float64[np.ndarray, "points 3"]
Colors = UInt8[np.ndarray, "points 3"]
MOST_HEADER = 4096  # bytes of a PCD header


def read_cloud(path: Path) -> tuple[Points, Colors | None, int]:
    """Points in the file's units, their colours if it has some, and how many were left out.

    Points that are not finite are left out.

    Raises:
        RecordingError: damaged, cut short, or without points.
    """
    try:
        points, colors = _ply(path) if path.suffix.lower() == ".ply" else _pcd(path)
    except RecordingError:
        raise
    except Exception as error:  # any bytes may come: readers fail in any way
        text = " ".join(str(error).split())[:120]
        raise RecordingError(f"{path}: damaged or no point cloud ({text})") from error
    good = np.isfinite(points).all(axis=1)
    if not good.any():
        raise RecordingError(f"{path}: no points can be read from it")
    bad = int(np.sum(~good))
    return points[good], None if colors is None else colors[good], bad


def _ply(path: Path) -> tuple[Points, Colors | None]:
    trimesh: Any = require_package("trimesh", extra="render")
    cloud = trimesh.load(str(path), process=False)
    colors = getattr(cloud, "colors", None)
    if colors is None and cloud.visual.kind == "vertex":
        colors = cloud.visual.vertex_colors
    points = np.array(cloud.vertices, np.float64).reshape(-1, 3)
    if colors is None or len(colors) != len(points):
        return points, None
    return points, np.array(colors, np.uint8)[:, :3]


def _pcd(path: Path) -> tuple[Points, Colors | None]:
    _check_pcd(path)
    o3d: Any = require_package("open3d", extra="render")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(str(path))
    points = np.array(cloud.points, np.float64).reshape(-1, 3)
    if not cloud.has_colors():
        return points, None
    colors = np.clip(np.nan_to_num(np.asarray(cloud.colors)), 0.0, 1.0)
    return points, np.rint(colors * 255).astype(np.uint8)


def _check_pcd(path: Path) -> None:
    """Refuse what Open3D reads as something else: it fills gaps and turns unknown types to 0.

    Raises:
        RecordingError: no header, a type that is not read, or other points than it says.
    """
    data = path.read_bytes()
    head, found, rest = data[:MOST_HEADER].partition(b"\nDATA ")
    kind = rest.partition(b"\n")[0].strip().decode("ascii", "replace")
    lines = (line.split() for line in head.decode("ascii", "replace").splitlines())
    fields = {line[0]: line[1:] for line in lines if line}
    if not found or not {"FIELDS", "SIZE", "TYPE", "POINTS"} <= set(fields):
        raise RecordingError(f"{path}: it has no PCD header")
    if kind not in ("ascii", "binary", "binary_compressed"):
        raise RecordingError(
            f"{path}: its data are {kind[:20]!r}; known are ascii, binary and binary_compressed"
        )
    count = int(fields["POINTS"][0])
    sizes = [int(size) for size in fields["SIZE"]]
    counts = [int(value) for value in fields.get("COUNT", ["1"] * len(sizes))]
    types = zip(fields["FIELDS"], fields["TYPE"], sizes, strict=True)
    forms = {name: f"{kind} {size}" for name, kind, size in types}
    if kind != "ascii" and any(forms.get(axis) != "F 4" for axis in "xyz"):
        raise RecordingError(
            f"{path}: x, y and z must be floats of 4 bytes (TYPE F, SIZE 4), got "
            f"{', '.join(forms.get(axis, 'none') for axis in 'xyz')}"
        )
    body = data[len(head) + len(found) + len(rest.partition(b"\n")[0]) + 1 :]
    row = sum(size * number for size, number in zip(sizes, counts, strict=True))
    if kind == "ascii":
        _check_rows(path, body, count, sum(counts))
        return
    needed = count * row
    if kind == "binary_compressed":  # begins with its own length and that of the points
        claimed = int.from_bytes(body[4:8], "little")
        if claimed != needed:
            raise RecordingError(f"{path}: {claimed} bytes for {count} points of {row}")
        needed = int.from_bytes(body[:4], "little") + 8
    if len(body) < needed:
        raise RecordingError(f"{path}: the cloud was cut short")


def _check_rows(path: Path, body: bytes, count: int, columns: int) -> None:
    rows = [line.split() for line in body.splitlines() if line.strip()]
    if len(rows) < count:
        raise RecordingError(f"{path}: the cloud was cut short")
    for number, row in enumerate(rows[:count]):
        try:
            good = len(row) == columns and [float(value) for value in row]
        except ValueError:
            good = False
        if not good:
            raise RecordingError(f"{path}: point {number} is damaged, {columns} numbers expected")
