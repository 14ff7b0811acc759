"""The `data.h5` (or `dataset.h5`) of DoughNet's authors becomes a dataset.

The file has meshes, genus and fingers, no particles and no times. What we put in their place is
said in the stage of each layer: points drawn inside the meshes, which have no identity over time,
times at the authors' rate of key frames, and a scene graph that is right in its topology alone.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from doughdata.dataset import DatasetSettings, DatasetWriter, StageRecord, open_writer
from doughdata.recordings.authors_scene import LABEL_SPACING, AuthorsScene
from doughdata.recordings.protocol import Conversion, Loss, OnProgress
from doughdata.registry import require_package
from doughschemas import BadInputError, DoughError, MissingPackageError, Scene

__all__ = ["AuthorsH5"]

SECONDS_PER_FRAME = 0.032  # of the authors' simulation
MAGIC = b"\x89HDF\r\n\x1a\n"
NEEDED = ("obj_verts", "obj_face_labels", "ee_verts")
LAYERS = ("sim", "topology", "mesh")


class AuthorsH5:
    """Scenes with meshes; a group of observed points alone (`real`) has none and is left out."""

    def takes(self, path: Path) -> bool:
        """Whether this is an HDF5 file."""
        try:
            with path.open("rb") as file:
                return file.read(len(MAGIC)) == MAGIC
        except OSError:
            return False

    def convert(
        self,
        path: Path,
        dataset: str,
        *,
        on_progress: OnProgress | None = None,
        points: int = 4096,
        seconds_per_frame: float = SECONDS_PER_FRAME,
    ) -> Conversion:
        """Read a file; its groups, if it has some, are splits: `train`, and `test` for all others.

        Args:
            path: the file.
            dataset: where to; all its scenes must have as many key frames as the file.
            on_progress: hears how far it is.
            points: drawn inside the meshes of each key frame.
            seconds_per_frame: time from one key frame to the next.

        A scene that cannot be used is a loss, told with its reason. The same call again resumes.

        Raises:
            BadInputError: no such file, or not one scene can be used.
            DatasetError: the dataset has another number of key frames or other stages.
            MissingPackageError: h5py, trimesh or open3d is not installed.
        """
        h5py = require_package("h5py", extra="h5")
        _load_codecs()
        try:
            file = h5py.File(path, "r")
        except OSError as error:
            raise BadInputError(f"{path} cannot be read as HDF5: {error}") from error
        with file, TemporaryDirectory() as folder:
            groups, losses = _groups(file, path)
            sources = [s for g in groups for s in _sources(g, path, seconds_per_frame)]
            scenes: dict[str, tuple[AuthorsScene, Scene]] = {}
            for source in sources:
                try:
                    scenes[source.scene_id] = source, source.scene(Path(folder))
                except (DoughError, OSError, ValueError) as error:
                    losses.append(_loss(source, error))
            if not scenes:
                reason = f": {losses[0]}" if losses else ""
                raise BadInputError(f"{path}: no scene can be used{reason}")
            work = _Work(path, dataset, points, list(scenes.values()), on_progress)
            return work.run(losses)


class _Work:
    """Plans all scenes, then writes them layer after layer."""

    def __init__(
        self,
        path: Path,
        dataset: str,
        points: int,
        scenes: Sequence[tuple[AuthorsScene, Scene]],
        on_progress: OnProgress | None,
    ) -> None:
        self._path, self._points, self._on_progress = path, points, on_progress
        self._by_id = {scene.scene_id: source for source, scene in scenes}
        self._stages = _stages(points, scenes[0][0].step)
        frames = {source.num_frames for source, _ in scenes}
        if len(frames) > 1:
            raise BadInputError(f"{path}: groups differ in their key frames: {sorted(frames)}")
        self._writer = open_writer(
            dataset, DatasetSettings(num_frames=frames.pop(), stages=self._stages)
        )
        self._shards = self._writer.plan_scenes([scene for _, scene in scenes])

    def run(self, losses: list[Loss]) -> Conversion:
        """Write what is missing."""
        writer = self._writer
        for layer in LAYERS:
            tasks = writer.tasks(layer, shards=self._shards)
            for done, task in enumerate(tasks):
                if self._on_progress is not None:
                    self._on_progress(layer, done, len(tasks))
                self._write(writer, layer, task, losses)
        writer.refresh()
        indices = tuple(i for shard in self._shards for i in shard.scene_indices)
        return Conversion(
            dataset=writer.uri,
            scenes=indices,
            frames=len(indices) * writer.num_frames,
            losses=tuple(losses),
            figures={"points": self._points},
        )

    def _write(self, writer: DatasetWriter, layer: str, task: Any, losses: list[Loss]) -> None:
        records, failed = {}, {}
        for index, scene in writer.scenes(task).items():
            source = self._by_id[scene.scene_id]
            try:
                records[index] = source.record(layer, self._points)
            except (DoughError, ValueError) as error:
                failed[index] = " ".join(str(error).split())
                losses.append(_loss(source, error))
        writer.write(task, records, stage=self._stages[layer], failed=failed)


def _groups(file: Any, path: Path) -> tuple[list[tuple[str, Any]], list[Loss]]:
    """(name, group) of what has meshes; what has none is a loss."""
    found = (
        {"": file} if "obj_verts" in file else {k: v for k, v in file.items() if hasattr(v, "keys")}
    )
    groups, losses = [], []
    for name, group in found.items():
        missing = [key for key in NEEDED if key not in group]
        if missing:
            count = int(group["scene"].shape[0]) if "scene" in group else 1
            reason = f"no {missing[0]}: observed points alone make no scene"
            losses.append(Loss(where=name or path.name, count=count, unit="scene", reason=reason))
        else:
            groups.append((name, group))
    return groups, losses


def _sources(group: tuple[str, Any], path: Path, step: float) -> Iterator[AuthorsScene]:
    name, content = group
    label = f"{path.stem}-{name}" if name else path.stem
    for row in range(content["obj_verts"].shape[0]):
        yield AuthorsScene(
            group=content,
            row=row,
            scene_id=f"{label}-{row:06d}",
            split="train" if name in ("", "train") else "test",
            step=step,
        )


def _stages(points: int, step: float) -> dict[str, StageRecord]:
    """What the layers say about how they were made."""
    told = {
        "sim": {"points": points, "identity_over_time": False, "seconds_per_frame": step},
        "topology": {"points": points, "graph": "schematic", "events": False},
        "mesh": {"label_spacing": LABEL_SPACING},
    }
    here = version("doughdata")
    return {
        layer: StageRecord(name="doughnet-h5", version=here, config=config)
        for layer, config in told.items()
    }


def _loss(source: AuthorsScene, error: Exception) -> Loss:
    return Loss(where=source.scene_id, count=1, unit="scene", reason=" ".join(str(error).split()))


def _load_codecs() -> None:
    """The authors' files are compressed by a plug-in of HDF5, if it is installed."""
    with suppress(MissingPackageError):
        require_package("hdf5plugin", extra="h5")
