"""Converter `bag`: ROS 1 .bag files and rosbag2 (sqlite3 or MCAP), read by rosbags."""

from dataclasses import replace
from pathlib import Path

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.files import starts_with
from doughdata.recordings.protocol import Loss, OnProgress
from doughdata.recordings.source import Source
from doughdata.recordings.stream_converter import StreamConverter

__all__ = ["Bag"]

MAGIC = b"#ROSBAG"
FILES = (".bag", ".db3")
PARTS = (".db3", ".mcap")


class Bag(StreamConverter):
    """ROS 1 bags, and files or folders as `ros2 bag record` makes them."""

    def takes(self, path: Path) -> bool:
        """A .bag or .db3 file, or a folder with a rosbag2 description or storage files."""
        if path.is_dir():
            try:
                names = [entry.name for entry in path.iterdir()]
            except OSError:
                return False
            return "metadata.yaml" in names or any(name.endswith(PARTS) for name in names)
        return path.suffix.lower() in FILES or starts_with(path, MAGIC)

    def open(self, path: Path, on_progress: OnProgress) -> Source:
        """Read a file, or all files of a folder, through once."""
        from doughdata.recordings.bag_source import BagSource
        from doughdata.recordings.joined_source import JoinedSource
        from doughdata.recordings.mcap_source import McapSource
        from doughdata.recordings.rosbag2 import read_folder

        if not path.is_dir():
            return BagSource(path, on_progress=on_progress)
        folder = read_folder(path)
        if folder.compressed or not folder.parts:
            return BagSource(path, on_progress=on_progress)
        parts: list[Source] = []
        losses = list(folder.losses)
        for part in folder.parts:
            # Of MCAP our own reader tells what is lost.
            kind = McapSource if part.suffix == ".mcap" else BagSource
            try:
                parts.append(kind(part, on_progress=on_progress))
            except RecordingError as error:
                if len(folder.parts) == 1:
                    raise
                losses.append(Loss(where=part.name, count=1, unit="file", reason=str(error)))
        return JoinedSource(parts, replace(folder, losses=tuple(losses)))
