"""Converter `mcap`: what a robot recorded, as one scene with the layer `depth.recorded`."""

from pathlib import Path

from doughdata.recordings.conversion import convert_recording
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.files import check_readable, starts_with
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.recordings.protocol import Conversion, OnProgress, silent
from doughdata.recordings.request import Request
from doughdata.recordings.source import Source

__all__ = ["Mcap"]

MAGIC = b"\x89MCAP"


class Mcap:
    """MCAP files: ROS 2 (CDR), ROS 1 and Foxglove (Protobuf) messages."""

    def takes(self, path: Path) -> bool:
        """A file that begins like MCAP or is called so."""
        return path.is_file() and (path.suffix.lower() == ".mcap" or starts_with(path, MAGIC))

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
        """Convert one recording; see `Converter.convert`.

        Args:
            path: the file.
            dataset: where the scene goes.
            topics: which messages are used.
            processing: numbers of all steps.
            salvage: take what can be read of a damaged file, and record the loss.
            save_steps: folder for a contact sheet of the steps.
            on_progress: told how far it is.

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
        from doughdata.recordings.mcap_source import McapSource
    except ModuleNotFoundError as error:
        from doughschemas import MissingPackageError

        raise MissingPackageError(str(error.name), "mcap") from error
    try:
        return McapSource(path, on_progress=on_progress)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from error
