"""Contact sheet: a few key frames of a few scenes, all layers, as one PNG."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from doughdata.geometry import transform_points
from doughdata.view.layout import SceneStrip, draw_sheet
from doughdata.view.panels import Picture
from doughdata.view.recorded import draw_recordings, recorded_scenes
from doughdata.view.scene_data import ViewDataset, chosen_sensor, ranges, scene_title, tool_shape
from doughschemas import (
    BadInputError,
    DepthViews,
    MissingLayerError,
    Particles,
    TopologyEvent,
)

__all__ = ["save_sheet"]

MOST_SCENES = 4
COLUMNS = 6


def save_sheet(
    dataset: ViewDataset,
    path: str | Path,
    *,
    scenes: Iterable[int] | None = None,
    frames: Iterable[int] | None = None,
    sensor: str | None = None,
) -> Path:
    """Save a contact sheet as PNG and return its path.

    By default at most four scenes, evenly spread over the dataset, and of each six key frames out
    of those that `doughdata render` takes, with the ones right after a change of topology.
    `sensor` names a depth layer; by default it is the first. Recordings have a sheet of their own.

    Raises:
        BadInputError: not a `.png` path, an empty dataset, a path that cannot be
            written, or a scene, frame or sensor that is not there.
        MissingPackageError: matplotlib is not installed.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise BadInputError(f"a contact sheet is saved as .png, got {path.name!r}")
    there = list(dataset.scene_indices)
    if not there:
        raise BadInputError("the dataset holds no scene yet: run `doughdata generate` first")
    recorded = recorded_scenes(dataset)
    default = [scene for scene in there if scene not in recorded] or there
    chosen = (
        [default[i] for i in _spread(len(default), MOST_SCENES)] if scenes is None else list(scenes)
    )
    if wrong := [scene for scene in chosen if scene not in there]:
        raise BadInputError(f"no scene {wrong[0]}: the dataset holds {ranges(there)}")
    wanted = None if frames is None else tuple(frames)
    if chosen and all(scene in recorded for scene in chosen):
        figure = draw_recordings(dataset, chosen)
    elif mixed := [scene for scene in chosen if scene in recorded]:
        raise BadInputError(f"scene {mixed[0]} is a recording: show it on a sheet of its own")
    else:
        sensor = chosen_sensor(dataset, sensor)
        strips = [_strip(dataset, scene, wanted, sensor) for scene in chosen]
        figure = draw_sheet(strips, caption=f"{len(chosen)} of {len(there)} scenes")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error
    return path


def _spread(total: int, most: int) -> list[int]:
    """At most `most` of the indices 0..total-1, evenly spread, both ends included."""
    return sorted({round(x) for x in np.linspace(0, total - 1, min(total, most))})


def _strip(
    dataset: ViewDataset, index: int, wanted: tuple[int, ...] | None, sensor: str
) -> SceneStrip:
    """Read what the sheet shows of one scene."""
    scene, particles = dataset.scene(index), dataset.read_particles(index)
    topology = _if_made(lambda: dataset.read_topology(index))
    events = topology.events if topology else ()
    total = len(particles.timestamps)
    frames = _default_frames(total, events) if wanted is None else wanted
    if wrong := [frame for frame in frames if not 0 <= frame < total]:
        raise BadInputError(f"scene {index} has no key frame {wrong[0]}, but 0..{total - 1}")
    corners = [tool_shape(scene.tools[action.tool]).vertices for action in scene.actions]
    pictures = []
    for frame in frames:
        layers = dataset.frame(scene=index, frame=frame)
        views: DepthViews | None = None
        if sensor:
            views = _if_made(lambda layers=layers: layers.depth(sensor))
        depth = segments = None
        if views is not None and len(views.depth):
            depth, segments = views.depth[0] * np.float32(views.depth_unit), views.segments[0]
        pictures.append(
            Picture(
                positions=particles.positions[frame],
                fingers=_posed(corners, particles, frame),
                topology=topology.frames[frame] if topology else None,
                meshes=_if_made(lambda layers=layers: layers.meshes),
                depth=depth,
                segments=segments,
            )
        )
    return SceneStrip(
        title=scene_title(index, scene),
        frames=frames,
        times=tuple(float(particles.timestamps[frame]) for frame in frames),
        pictures=tuple(pictures),
        events=events,
        sensor=sensor,
    )


def _if_made(read: Callable[[], Any]) -> Any:
    """What `read` gives, or None where that layer was not made."""
    try:
        return read()
    except MissingLayerError:
        return None


def _default_frames(total: int, events: Sequence[TopologyEvent]) -> tuple[int, ...]:
    """Six of the frames that `doughdata render` takes; those right after an event come first."""
    rendered = [frame for frame in range(5, 66, 5) if frame < total]
    if len(rendered) < COLUMNS:
        return tuple(_spread(total, COLUMNS))
    after = {next((f for f in rendered if f >= event.frame), rendered[-1]) for event in events}
    chosen = set(sorted({rendered[0], rendered[-1]} | after)[:COLUMNS])
    for frame in [rendered[i] for i in _spread(len(rendered), COLUMNS)] + rendered:
        if len(chosen) < COLUMNS:
            chosen.add(frame)
    return tuple(sorted(chosen))


def _posed(
    corners: Sequence[Float[np.ndarray, "points 3"]], particles: Particles, frame: int
) -> tuple[Float64[np.ndarray, "points 3"], ...]:
    poses = particles.tool_poses
    return tuple(
        transform_points(corners[int(poses.action[frame])], position, quaternion)
        for position, quaternion in zip(poses.position[frame], poses.quaternion[frame], strict=True)
    )
