"""Packages of the extra `train`, imported when they are needed."""

from importlib import import_module
from typing import Any

from doughschemas import MissingPackageError

__all__ = ["train_package"]


def train_package(name: str) -> Any:
    """Import a package that training or weights need.

    Raises:
        MissingPackageError: it is not installed; the message names the extra.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        package = (error.name or name).partition(".")[0]
        raise MissingPackageError(package, "train") from error
