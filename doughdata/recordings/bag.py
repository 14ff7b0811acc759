"""Converter `bag`: ROS 1 .bag files and rosbag2 folders (sqlite3 or MCAP), read by rosbags."""

from pathlib import Path

from doughdata.recordings.conversion import convert_recording
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.files import check_readable, starts_with
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.recordings.protocol import Conversion, OnProgress, silent
from doughdata.recordings.request import Request
from doughdata.recordings.source import Source
from doughschemas import MissingPackageError

__all__ = ["Bag"]

MAGIC = b"#ROSBAG"
PARTS = (".db3", ".mcap")


class Bag:
    """ROS 1 bags, and folders as `ros2 bag record` makes them."""

    def takes(self, path: Path) -> bool:
        """A .bag file, or a folder with a rosbag2 description or storage files."""
        if path.is_dir():
            try:
                names = [entry.name for entry in path.iterdir()]
            except OSError:
                return False
            return "metadata.yaml" in names or any(name.endswith(PARTS) for name in names)
        return path.suffix.lower() == ".bag" or starts_with(path, MAGIC)

    def convert(
        self,
        path: Path,
        dataset: str,
        *,
        topics: TopicOptions | None = None,
        processing: ProcessingConfig | None = None,
        salvage: bool = False,
        save_steps: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Conversion:
        """Convert one recording; options as those of converter `mcap`.

        Raises:
            RecordingError: damaged without `salvage`, or without depth, calibration or dough.
            DatasetError: the dataset cannot be written.
        """
        check_readable(path)
        request = Request(
            path=path,
            dataset=dataset,
            topics=topics or TopicOptions(),
            processing=processing or ProcessingConfig(),
            salvage=salvage,
            save_steps=save_steps,
            on_progress=on_progress or silent,
        )
        return convert_recording(request, self, _open)


def _open(path: Path, on_progress: OnProgress) -> Source:
    try:
        from doughdata.recordings.bag_source import BagSource
        from doughdata.recordings.joined_source import JoinedSource
        from doughdata.recordings.mcap_source import McapSource
    except ModuleNotFoundError as error:
        raise MissingPackageError(str(error.name), "mcap") from error
    try:
        parts = sorted(path.glob("*.mcap")) if path.is_dir() else []
        if parts:  # our own reader tells what is lost
            return JoinedSource([McapSource(part, on_progress=on_progress) for part in parts])
        return BagSource(path, on_progress=on_progress)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from error
