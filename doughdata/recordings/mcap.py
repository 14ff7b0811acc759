"""Converter `mcap`: what a robot recorded, as one scene with the layer `depth.recorded`."""

from pathlib import Path

from doughdata.recordings.files import starts_with
from doughdata.recordings.protocol import OnProgress
from doughdata.recordings.source import Source
from doughdata.recordings.stream_converter import StreamConverter

__all__ = ["Mcap"]

MAGIC = b"\x89MCAP"


class Mcap(StreamConverter):
    """MCAP files: ROS 2 (CDR), ROS 1 and Foxglove (Protobuf) messages."""

    def takes(self, path: Path) -> bool:
        """A file that begins like MCAP or is called so."""
        return path.is_file() and (path.suffix.lower() == ".mcap" or starts_with(path, MAGIC))

    def open(self, path: Path, on_progress: OnProgress) -> Source:
        """Read the file through once."""
        from doughdata.recordings.mcap_source import McapSource

        return McapSource(path, on_progress=on_progress)
