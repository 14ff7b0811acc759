"""LeRobot dataset v3.0 (huggingface/lerobot): an episode a scene, a frame a key frame.

LeRobot knows one frame rate; our key frames are uniform over each scene's own duration. So `fps` is
nominal, and the true times stand in `observation.time`.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset import Dataset
from doughdata.dataset.statistics import Moments
from doughdata.exporters.folders import new_folder
from doughdata.exporters.lerobot_files import (
    CHUNK,
    DATA_PATH,
    FILE_BYTES,
    DataFiles,
    Episode,
    arrow_type,
    feature,
    split_ranges,
    task_table,
)
from doughdata.exporters.rows import (
    STATE_NAMES,
    Image,
    chosen_sensors,
    image_names,
    png,
    rows_of,
    scene_images,
    scene_splits,
    scene_states,
)
from doughschemas import BadInputError, MissingLayerError

__all__ = ["LeRobot"]

VERSION = "v3.0"
COMPONENTS = 8  # length of `observation.genus`; -1 = there is no such component
SCALARS = {  # feature -> column of the key frames
    "observation.time": "timestamp",
    "observation.num_components": "num_components",
    "observation.ambiguous": "ambiguous",
}
INDEX = {  # columns that every LeRobot dataset has
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


class LeRobot:
    """`meta/`, `data/`: what `LeRobotDataset(repo_id, root=folder)` opens."""

    def export(
        self,
        dataset: Dataset,
        scenes: Sequence[int],
        out: Path,
        *,
        sensors: str | None = None,
        near: float = 0.2,
        far: float = 1.2,
        exact: bool = False,
    ) -> tuple[Path, ...]:
        """Write scenes.

        Args:
            dataset: with the layers `sim` and `topology`.
            scenes: scene indices; episodes follow their splits.
            out: a new or empty folder.
            sensors: comma-separated; by default all. Only key frames that every sensor has seen
                become frames.
            near: depth [m] that becomes black in the 8-bit images that policies take.
            far: depth [m] that becomes white; invalid pixels are black.
            exact: depth (u16, units of 0.1 mm or what the layer says) and segments as arrays, too.

        Raises:
            BadInputError: no scene, a range that is none, too many components, or a folder that is
                not empty.
            MissingLayerError: a layer that is needed was not made.
        """
        if not len(scenes):
            raise BadInputError("there is no scene to export")
        if not 0 <= near < far:
            raise BadInputError(f"depth needs 0 <= near < far, got {near:g} and {far:g} m")
        images = image_names(dataset, scenes, chosen_sensors(dataset, sensors))
        splits = scene_splits(dataset)
        order = sorted(scenes, key=lambda index: (splits[index] != "train", splits[index], index))
        with new_folder(out) as folder:
            export = _Export(dataset, images, near=near, far=far, exact=exact)
            export.write(folder, order, splits)
            written = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
        return tuple(out / path for path in written)


class _Export:
    """One run: features, statistics and places of the episodes are collected on the way."""

    def __init__(
        self,
        dataset: Dataset,
        images: Mapping[str, Sequence[str]],
        *,
        near: float,
        far: float,
        exact: bool,
    ) -> None:
        self._dataset, self._images = dataset, images
        self._near, self._far, self._exact = near, far, exact
        self._features: dict[str, Any] = {
            "observation.state": feature("float32", (len(STATE_NAMES),), list(STATE_NAMES)),
            "action": feature("float32", (len(STATE_NAMES),), list(STATE_NAMES)),
            "observation.time": feature("float32", (1,), ["seconds"]),
            "observation.num_components": feature("int64", (1,), None),
            "observation.genus": feature("int64", (COMPONENTS,), None),
            "observation.ambiguous": feature("bool", (1,), None),
        }
        self._tasks: dict[str, int] = {}
        self._episodes: list[dict[str, Any]] = []
        self._stats: dict[str, Moments] = {}
        self._frames = 0

    def write(self, folder: Path, order: Sequence[int], splits: Mapping[int, str]) -> None:
        """Data first, then what is known at its end."""
        durations = [self._dataset.scene(scene).duration for scene in order]
        keys = {scene: self._frame_keys(scene) for scene in order}
        step = np.median([np.median(np.diff(k)) if len(k) > 1 else 1 for k in keys.values()])
        rate = (self._dataset.num_frames - 1) / float(np.median(durations)) / float(step)
        fps = max(1, round(rate))
        files = DataFiles(folder)
        with files:
            for scene in order:
                episode = self._episode(scene, keys[scene], fps)
                self._note(scene, episode, files.place)
                files.write(episode, self._schema())
        self._write_meta(folder, fps, split_ranges([splits[scene] for scene in order]))

    def _frame_keys(self, scene: int) -> list[int]:
        """Key frames that every sensor has seen; all of them if there is no sensor."""
        if not self._images:
            return list(range(self._dataset.num_frames))
        seen = scene_images(self._dataset, scene, self._images)
        every = {name for names in self._images.values() for name in names}
        keys = sorted(key for key, images in seen.items() if set(images) == every)
        if not keys:
            raise MissingLayerError(
                f"{self._dataset.uri}: scene {scene} has no key frame that {', '.join(every)} "
                "have all seen; render it, or name fewer sensors with --option sensors=NAME"
            )
        return keys

    def _episode(self, scene: int, keys: Sequence[int], fps: int) -> Episode:
        self._dataset.layer("topology", scene)  # raises, and names the command that makes it
        episode, number = Episode(), len(self._episodes)
        seen = scene_images(self._dataset, scene, self._images)
        rows = {row["frame_index"]: row for row in rows_of(self._dataset, "frames", scene)}
        known = scene_states(self._dataset, scene)
        states = [known[key].astype(np.float32) for key in keys]
        task = self._tasks.setdefault(self._task(scene), len(self._tasks))
        for k, key in enumerate(keys):
            index = (k / fps, k, number, self._frames + k, task)
            for name, value in zip(INDEX, index, strict=True):
                episode.add(name, value, np.array([[value]]))
            for name, at in (("observation.state", k), ("action", min(k + 1, len(keys) - 1))):
                episode.add(name, states[at], states[at][None])
            self._add_topology(episode, scene, rows[key])
            for name, image in seen.get(key, {}).items():
                self._add_image(episode, name, image)
        return episode

    def _task(self, scene: int) -> str:
        return f"squeeze {self._dataset.scene(scene).family}"

    def _add_topology(self, episode: Episode, scene: int, row: Mapping[str, Any]) -> None:
        components = row["num_components"]
        if components > COMPONENTS:
            raise BadInputError(
                f"scene {scene}, key frame {row['frame_index']}: the LeRobot export holds "
                f"{COMPONENTS} components, got {components}"
            )
        genus = np.full(COMPONENTS, -1, np.int64)
        genus[:components] = row["genus"]
        episode.add("observation.genus", genus, genus[None])
        for name, column in SCALARS.items():
            episode.add(name, row[column], np.array([[row[column]]]))

    def _add_image(self, episode: Episode, name: str, image: Image) -> None:
        metres = image.depth * image.depth_unit
        scaled = np.clip((metres - self._near) / (self._far - self._near), 0.0, 1.0)
        scaled[image.depth == 0] = 0.0
        grey = np.rint(scaled * 255).astype(np.uint8)
        rgb = np.repeat(grey[..., None], 3, axis=2)
        key = f"observation.images.{name}"
        self._features[key] = {
            **feature("image", rgb.shape, ["height", "width", "channels"]),
            "info": {"is_depth_map": True, "near": self._near, "far": self._far},
        }
        value = {"bytes": png(rgb), "path": None}
        episode.add(key, value, rgb.reshape(-1, 3) / 255.0)
        if not self._exact:
            return
        for kind, array in (("depth", image.depth), ("segments", image.segments)):
            key, dtype = f"observation.{kind}.{name}", str(array.dtype)
            self._features[key] = feature(dtype, array.shape, ["height", "width"])
            if kind == "depth":
                self._features[key]["info"] = {"unit": image.depth_unit}
            episode.add(key, list(array), array.reshape(-1, 1))

    def _note(self, scene: int, episode: Episode, place: tuple[int, int]) -> None:
        """What `meta/episodes` says of an episode."""
        number = len(self._episodes)
        row = {
            "episode_index": number,
            "tasks": [self._task(scene)],
            "length": episode.length,
            "data/chunk_index": place[0],
            "data/file_index": place[1],
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + episode.length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "scene_index": scene,
            "scene_id": self._dataset.scene(scene).scene_id,
        }
        for name, moments in episode.stats.items():
            for kind, value in self._stat(name, moments).items():
                row[f"stats/{name}/{kind}"] = value
            self._stats.setdefault(name, Moments()).join(moments)
        self._episodes.append(row)
        self._frames += episode.length

    def _stat(self, name: str, moments: Moments) -> dict[str, Any]:
        """LeRobot's form: images (3, 1, 1) in 0..1, everything else one number a component."""
        found = moments.to_json()
        if self._features.get(name, {}).get("dtype") != "image":
            return found
        return {
            kind: value if kind == "count" else [[[number]] for number in value]
            for kind, value in found.items()
        }

    def _schema(self) -> pa.Schema:
        """Arrow types of a frame."""
        columns = [(name, arrow_type(f["dtype"], f["shape"])) for name, f in self._features.items()]
        columns += [(name, arrow_type(dtype, (1,))) for name, dtype in INDEX.items()]
        return pa.schema(columns)

    def _write_meta(self, folder: Path, fps: int, splits: Mapping[str, str]) -> None:
        index = {name: feature(dtype, (1,), None) for name, dtype in INDEX.items()}
        info = {
            "codebase_version": VERSION,
            "robot_type": "parallel_gripper",
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": FILE_BYTES // 2**20,
            "video_files_size_in_mb": 200,
            "fps": fps,
            "splits": dict(splits),
            "data_path": DATA_PATH,
            "video_path": None,
            "features": {**self._features, **index},
        }
        meta = folder / "meta"
        (meta / "episodes/chunk-000").mkdir(parents=True)
        (meta / "info.json").write_text(json.dumps(info, indent=4))
        stats = {name: self._stat(name, moments) for name, moments in self._stats.items()}
        (meta / "stats.json").write_text(json.dumps(stats, indent=4))
        episodes = pa.Table.from_pylist(self._episodes)
        pq.write_table(episodes, meta / "episodes/chunk-000/file-000.parquet")
        pq.write_table(task_table(self._tasks), meta / "tasks.parquet")
