"""Where a plan starts and what it is to reach: a key frame, a mesh, or a coloured point cloud."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from doughdata.dataset import Frame, open_dataset
from doughdata.registry import require_package
from doughdata.torch.sampling import dough_points
from doughschemas import BadInputError, ComponentMesh, Scene

__all__ = ["Source", "read_source"]

NUM_POINTS = 1024
MOST_COMPONENTS = 4  # that colours can name
LARGEST = 0.5  # [m]; a larger file is in millimetres
FRAME = re.compile(r"(?:(?P<uri>.+)#)?(?P<scene>\d+):(?P<frame>\d+)")
SUFFIXES = (".ply", ".obj", ".stl", ".glb")


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Dough as it is seen, and what else is known of it."""

    name: str
    points: Float64[np.ndarray, "points 3"]  # [m], world
    labels: Int64[np.ndarray, " points"]  # component, negative = none
    scene: Scene | None = None  # of a simulated key frame
    frame: Frame | None = None  # of a dataset
    num_frames: int = 0  # key frames of that scene ...
    key_frames: tuple[int, ...] = ()  # ... and those that a model steps through
    meshes: tuple[ComponentMesh, ...] = ()  # of a mesh file


def read_source(text: str, *, dataset: str, sensor: str, seed: int = 0) -> Source:
    """Read SCENE:FRAME of the dataset, URI#SCENE:FRAME of another one, or a file.

    A mesh is looked at through the default camera, so that only its visible side is known of it. In
    a point cloud every colour is a component.

    Raises:
        BadInputError: none of these, a file that cannot be used, or no dough in sight.
    """
    rng = np.random.default_rng(seed)
    if match := FRAME.fullmatch(text):
        found = _key_frame(match, dataset, sensor, rng)
    else:
        found = _file(Path(text), rng)
    if (found.labels < 0).all():
        raise BadInputError(f"{text}: no dough is seen there")
    return found


def _key_frame(match: re.Match[str], dataset: str, sensor: str, rng: np.random.Generator) -> Source:
    from doughnet.data import key_frames

    uri = match["uri"] or dataset
    source = open_dataset(uri)
    scene, number = int(match["scene"]), int(match["frame"])
    frame = source.frame(scene=scene, frame=number)
    simulated = source.base_layer(scene) == "sim"
    views = frame.depth(sensor if simulated else "recorded")
    points, labels = dough_points(views, int(views.view_index[0]), NUM_POINTS, rng)
    return Source(
        name=f"{uri}#{scene}:{number}",
        points=points,
        labels=labels,
        scene=source.scene(scene) if simulated else None,
        frame=frame,
        num_frames=source.num_frames,
        key_frames=key_frames(source, sensor) if simulated else (),
    )


def _file(path: Path, rng: np.random.Generator) -> Source:
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        raise BadInputError(
            f"expected SCENE:FRAME, URI#SCENE:FRAME or a file ({', '.join(SUFFIXES)}), got {path}"
        )
    trimesh = require_package("trimesh", extra="sim")
    try:
        loaded = trimesh.load(path)
    except Exception as error:  # every loader has its own exceptions
        raise BadInputError(f"{path} cannot be read: {error}") from error
    if isinstance(loaded, trimesh.Scene):
        loaded = loaded.to_mesh()
    if len(loaded.vertices) == 0:
        raise BadInputError(f"{path} holds no points")
    if not np.isfinite(loaded.vertices).all() or np.ptp(loaded.vertices, axis=0).max() > LARGEST:
        raise BadInputError(f"{path} must be in metres, at most {LARGEST} m long")
    if isinstance(loaded, trimesh.PointCloud):
        points, labels = _coloured(path, loaded)
        chosen = rng.choice(len(points), NUM_POINTS, replace=len(points) < NUM_POINTS)
        return Source(name=str(path), points=points[chosen], labels=labels[chosen])
    meshes = tuple(
        ComponentMesh(
            vertices=np.asarray(part.vertices, np.float32), faces=np.asarray(part.faces, np.uint32)
        )
        for part in loaded.split(only_watertight=False)
    )
    points, labels = _seen(meshes, rng)
    return Source(name=str(path), points=points, labels=labels, meshes=meshes)


def _coloured(
    path: Path, cloud: Any
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    """Points and the number of their colour; without colours all are one component."""
    points = np.asarray(cloud.vertices, np.float64)
    colours = cloud.colors
    if colours is None or len(colours) != len(points):
        return points, np.zeros(len(points), np.int64)
    _, labels = np.unique(np.asarray(colours)[:, :3], axis=0, return_inverse=True)
    count = int(labels.max()) + 1
    if count > MOST_COMPONENTS:
        raise BadInputError(
            f"{path} has {count} colours; expected one a component, at most {MOST_COMPONENTS}. Of "
            f"a photographed cloud make a dataset first: doughdata convert {path} --dataset X, "
            "then --goal X#0:0"
        )
    return points, labels.reshape(-1).astype(np.int64)


def _seen(
    meshes: tuple[ComponentMesh, ...], rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, " points"]]:
    from doughdata.render.cameras import default_camera
    from doughdata.render.depth import DepthRenderer, quantised
    from doughschemas import DepthViews

    camera, unit = default_camera(), 1e-4
    (image,) = DepthRenderer().render(meshes, (), (camera,))
    views = DepthViews(
        depth=quantised(image.depth, unit)[None],
        segments=image.segments[None],
        frame_index=np.zeros(1, np.int32),
        view_index=np.zeros(1, np.int32),
        cameras=(camera,),
        depth_unit=unit,
    )
    return dough_points(views, 0, NUM_POINTS, rng)
