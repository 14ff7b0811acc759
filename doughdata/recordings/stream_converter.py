"""The outer shell of converters of message streams: what differs is how a file is opened."""

from abc import ABC, abstractmethod
from pathlib import Path

from doughdata.recordings.conversion import convert_recording
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.files import check_readable
from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.recordings.protocol import Conversion, OnProgress, silent
from doughdata.recordings.request import Request
from doughdata.recordings.source import Source
from doughschemas import MissingPackageError

__all__ = ["StreamConverter"]


class StreamConverter(ABC):
    """A converter of recordings that are topics with messages; `takes` and `open` are its own."""

    @abstractmethod
    def takes(self, path: Path) -> bool:
        """Whether this looks like a file or folder of its kind; cheap, and never raises."""

    @abstractmethod
    def open(self, path: Path, on_progress: OnProgress) -> Source:
        """Read a recording through once.

        It may raise OSError, and ModuleNotFoundError of the packages of the extra `mcap`.

        Raises:
            RecordingError: it is no recording of this kind.
        """

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
            path: the file or folder.
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
        return convert_recording(request, self, self._opened)

    def _opened(self, path: Path, on_progress: OnProgress) -> Source:
        try:
            return self.open(path, on_progress)
        except ModuleNotFoundError as error:
            raise MissingPackageError(str(error.name), "mcap") from error
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from error
