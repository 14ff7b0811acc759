"""Open3D, imported late, with an error that says which system library it lacks."""

import re
from typing import Any

from doughschemas import DoughError

from doughdata.registry import require_package

__all__ = ["import_open3d", "system_library_error"]

# Shared libraries that the Open3D wheel takes from the system -> Debian package.
PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libgomp.so.1": "libgomp1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
}


def import_open3d() -> Any:
    """The module `open3d`.

    Raises:
        MissingPackageError: Open3D is not installed.
        DoughError: Open3D is installed, but a system library is not; the message has the line to
            type.
    """
    try:
        return require_package("open3d", extra="render")
    except ModuleNotFoundError:
        raise
    except ImportError as error:
        raise system_library_error(error) from error


def system_library_error(error: ImportError) -> DoughError:
    """Turn the dynamic loader's complaint into one line that says what to install."""
    found = re.search(r"\blib[^\s:]+\.so[.\d]*", str(error))
    library = found.group() if found else ""
    package = PACKAGES.get(library)
    if package is None:
        return DoughError(f"open3d is installed but cannot be loaded: {error}")
    return DoughError(
        f"open3d needs the system library {library}: apt-get install -y {package} (as root)"
    )
