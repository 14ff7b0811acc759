"""Names become objects here, through entry points, and only here."""

from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from doughschemas import MissingPackageError, UnknownNameError

__all__ = ["KINDS", "identity", "load", "names", "require_package"]

KINDS = {  # entry-point group -> what one of its entries is called in messages
    "scenes": "scene family",
    "shapes": "shape",
    "simulators": "simulator",
    "topology": "topology check",
    "meshers": "mesher",
    "sensors": "sensor",
    "converters": "converter",
    "exporters": "exporter",
    "executors": "executor",
}
EXTRAS = {  # top-level package -> extra that installs it
    "taichi": "sim",
    "scipy": "sim",
    "skimage": "sim",
    "trimesh": "sim",
    "manifold3d": "sim",
    "open3d": "render",
    "cv2": "render",
    "pygltflib": "export",
    "matplotlib": "view",
    "viser": "serve",
    "h5py": "h5",
    "hdf5plugin": "h5",
    "torch": "train",
    "lightning_fabric": "train",
    "safetensors": "train",
    "tensorboard": "train",
    "mcap": "mcap",
    "mcap_ros1": "mcap",
    "mcap_ros2": "mcap",
    "mcap_protobuf": "mcap",
    "foxglove_schemas_protobuf": "mcap",
    "rosbags": "mcap",
    "ray": "ray",
    "s3fs": "s3",
}


@cache
def _entries(kind: str) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=f"doughdata.{kind}")}


def names(kind: str) -> list[str]:
    """Registered names of a kind, sorted."""
    return sorted(_entries(kind))


def load(kind: str, name: str) -> Any:
    """The registered class or factory.

    Raises:
        UnknownNameError: nobody registered that name; the message lists the known ones.
        MissingPackageError: the plug-in needs an extra that is not installed.
    """
    entries = _entries(kind)
    if name not in entries:
        raise UnknownNameError(KINDS[kind], name, entries)
    try:
        return entries[name].load()
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise MissingPackageError(package, EXTRAS[package]) from error


def identity(kind: str, plugin: object) -> tuple[str, str]:
    """Registered name and distribution version of a plug-in object; its path if unregistered."""
    path = f"{type(plugin).__module__}:{type(plugin).__qualname__}"
    for name, entry in _entries(kind).items():
        if entry.value == path:
            return name, entry.dist.version if entry.dist else ""
    return path, ""


def require_package(package: str, *, extra: str) -> Any:
    """Import an optional package.

    Raises:
        MissingPackageError: it is not installed; the message names the extra.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name and error.name.partition(".")[0] != package.partition(".")[0]:
            raise
        raise MissingPackageError(package.partition(".")[0], extra) from error
