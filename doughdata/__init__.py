"""doughdata: data about soft bodies that split, merge and get holes."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from doughdata.dataset import Dataset

__all__ = ["__version__", "open_dataset"]
__version__ = "0.1.0"


def open_dataset(uri: str | Path) -> "Dataset":
    """Open a dataset for reading: a local folder or an fsspec URI. See `doughdata.dataset`."""
    from doughdata.dataset import open_dataset as open_

    return open_(uri)
