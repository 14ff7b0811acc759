"""Open3D, imported late, with an error that says which system library it lacks."""

import re
from typing import Any

from doughdata.registry import require_package
from doughschemas import DoughError, MissingPackageError

__all__ = ["MissingLibraryError", "import_open3d", "system_library_error"]

# Shared libraries that the Open3D wheel takes from the system -> Debian package.
PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libgomp.so.1": "libgomp1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
}


class MissingLibraryError(MissingPackageError):
    """Open3D is installed, but a library of the system is not; the message says what to type."""

    def __init__(self, message: str) -> None:
        DoughError.__init__(self, message)
        self.package, self.extra = "open3d", "render"


def import_open3d() -> Any:
    """The module `open3d`.

    Raises:
        MissingPackageError: Open3D is not installed.
        MissingLibraryError: it is, but a library of the system is not.
    """
    try:
        return require_package("open3d", extra="render")
    except ModuleNotFoundError:
        raise
    except ImportError as error:
        raise system_library_error(error) from error


def system_library_error(error: ImportError) -> MissingLibraryError:
    """Turn the dynamic loader's complaint into one line that says what to install."""
    found = re.search(r"\blib[^\s:]+\.so[.\d]*", str(error))
    library = found.group() if found else ""
    package = PACKAGES.get(library)
    if package is None:
        return MissingLibraryError(f"open3d is installed but cannot be loaded: {error}")
    return MissingLibraryError(
        f"open3d needs the system library {library}: apt-get install -y {package} (as root)"
    )
