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


def read_cloud(path: Path) -> tuple[Points, Colors | None]:
    """Points in the file's units, and their colours if it has some.

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
    return points[good], None if colors is None else colors[good]


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
    """Whether as many points are there as the header says."""
    data = path.read_bytes()
    head, found, rest = data[:MOST_HEADER].partition(b"\nDATA ")
    kind = rest.partition(b"\n")[0].strip().decode("ascii", "replace")
    lines = (line.split() for line in head.decode("ascii", "replace").splitlines())
    fields = {line[0]: line[1:] for line in lines if line}
    if not found or "POINTS" not in fields or "SIZE" not in fields:
        raise RecordingError(f"{path}: it has no PCD header")
    count = int(fields["POINTS"][0])
    sizes = [int(size) for size in fields["SIZE"]]
    counts = [int(value) for value in fields.get("COUNT", ["1"] * len(sizes))]
    body = data[len(head) + len(found) + len(rest.partition(b"\n")[0]) + 1 :]
    if kind == "ascii":
        there, needed = len(body.split(b"\n")) - body.endswith(b"\n"), count
    elif kind == "binary":
        needed = count * sum(s * n for s, n in zip(sizes, counts, strict=True))
        there = len(body)
    else:  # binary_compressed: its own length comes first
        needed, there = int.from_bytes(body[:4], "little") + 8, len(body)
    if there < needed:
        raise RecordingError(f"{path}: the cloud was cut short")
