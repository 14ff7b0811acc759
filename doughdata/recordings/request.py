"""What is converted, into what, and how."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from doughdata.recordings.options import ProcessingConfig, TopicOptions
from doughdata.recordings.protocol import OnProgress, silent

__all__ = ["Request"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What is converted, into what, and how."""

    path: Path
    dataset: str
    topics: TopicOptions
    processing: ProcessingConfig
    salvage: bool = False  # take what can be read of a damaged recording
    save_steps: Path | None = None  # folder for a contact sheet of the steps
    on_progress: OnProgress = silent

    def options(self) -> dict[str, Any]:
        """All that decides about the result."""
        return {"topics": asdict(self.topics), "processing": self.processing.to_json()}
