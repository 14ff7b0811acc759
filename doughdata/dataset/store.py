"""Where a dataset lies: a folder, behind the few operations that the commit protocol needs."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Protocol, runtime_checkable
from uuid import uuid4

from doughschemas import DamagedDatasetError, DatasetError

__all__ = ["LocalStore", "Store", "explain_os_errors", "store_of"]

TEMPORARY = ".tmp-"  # prefix of files that are not published yet
HINTS = {
    errno.ENOSPC: "free some space and run the same command again, nothing finished is lost",
    errno.EDQUOT: "free some space and run the same command again, nothing finished is lost",
    errno.EFBIG: "raise the file size limit and run the same command again",
    errno.EROFS: "the medium is read-only, choose another --dataset",
    errno.EACCES: "permission is missing, choose another --dataset or change its owner",
    errno.EPERM: "permission is missing, or the file system has no hard links",
    errno.ENOTDIR: "a file stands where a folder is needed",
}


@runtime_checkable
class Store(Protocol):
    """Files below one root; paths are relative and use `/`."""

    @property
    def uri(self) -> str:
        """The root, as the user wrote it."""
        ...

    def read(self, path: str) -> bytes:
        """Whole file.

        Raises:
            DamagedDatasetError: it is missing or cannot be read.
        """
        ...

    def exists(self, path: str) -> bool:
        """Whether a file or folder is there."""
        ...

    def names(self, folder: str) -> list[str]:
        """Sorted names directly in a folder; empty if it is missing."""
        ...

    def walk(self, folder: str) -> list[str]:
        """Sorted paths, relative to `folder`, of all files in it and below."""
        ...

    def create(self, path: str, data: bytes) -> bool:
        """Publish a file unless it exists; atomic and durable. False = it existed."""
        ...

    def replace(self, path: str, data: bytes) -> None:
        """Write or overwrite a file; readers see the old or the new one, never a part."""
        ...

    def local(self, path: str) -> Path:
        """Path on this machine."""
        ...


class LocalStore:
    """A folder on a local or mounted file system."""

    def __init__(self, uri: str | Path) -> None:
        self._uri = str(uri)
        self._root = Path(self._uri.removeprefix("file://")).absolute()

    @property
    def uri(self) -> str:
        """The root, as the user wrote it."""
        return self._uri

    def read(self, path: str) -> bytes:
        """Whole file; see `Store.read`."""
        try:
            return self.local(path).read_bytes()
        except FileNotFoundError as error:
            raise DamagedDatasetError(f"{self._uri}: {path} is missing") from error
        except OSError as error:
            raise DamagedDatasetError(
                f"{self._uri}: cannot read {path}: {error.strerror}"
            ) from error

    def exists(self, path: str) -> bool:
        """Whether a file or folder is there."""
        return self.local(path).exists()

    def names(self, folder: str) -> list[str]:
        """Sorted names directly in a folder; unpublished files are left out."""
        try:
            names = [entry.name for entry in self.local(folder).iterdir()]
        except (FileNotFoundError, NotADirectoryError):
            return []
        return sorted(name for name in names if not name.startswith(TEMPORARY))

    def walk(self, folder: str) -> list[str]:
        """Sorted paths, relative to `folder`, of all files in it and below."""
        root = self.local(folder)
        return sorted(
            path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()
        )

    def create(self, path: str, data: bytes) -> bool:
        """Publish a file unless it exists: a hard link to a finished file never replaces."""
        target = self.local(path)
        with explain_os_errors(self._uri, f"write {path}"), _temporary(target, data) as temporary:
            try:
                os.link(temporary, target)
            except FileExistsError:
                return False
        sync_folder(target.parent)
        return True

    def replace(self, path: str, data: bytes) -> None:
        """Write or overwrite a file atomically."""
        target = self.local(path)
        with explain_os_errors(self._uri, f"write {path}"), _temporary(target, data) as temporary:
            temporary.replace(target)
            sync_folder(target.parent)

    def local(self, path: str) -> Path:
        """Path on this machine."""
        return self._root / path if path else self._root


def store_of(uri: "str | Path | Store") -> Store:
    """The store behind a URI.

    Raises:
        DatasetError: a URI that this release cannot reach; the message names what works.
    """
    if not isinstance(uri, str | Path):
        return uri
    scheme, separator, _ = str(uri).partition("://")
    if separator and scheme != "file":
        raise DatasetError(
            f"{uri}: {scheme}:// is not supported by this release; give a local folder "
            "(or mount the bucket and give its folder)"
        )
    return LocalStore(uri)


@contextmanager
def explain_os_errors(uri: str, doing: str) -> Iterator[None]:
    """Turn an operating system's error into one line that says what to do."""
    try:
        yield
    except OSError as error:
        hint = HINTS.get(error.errno or 0, "")
        reason = (error.strerror or str(error)).lower()
        raise DatasetError(
            f"{uri}: cannot {doing}: {reason}" + (f"; {hint}" if hint else "")
        ) from error


@contextmanager
def attempt_folder(folder: Path) -> Iterator[Path]:
    """A new folder that is removed again when what fills it fails."""
    folder.mkdir(parents=True)
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def sync_tree(folder: Path) -> dict[str, str]:
    """Flush all files below a folder to the disk; returns name -> sha256, sorted by name."""
    hashes = {}
    for path in sorted(folder.rglob("*")):
        if path.is_dir():
            sync_folder(path)
            continue
        with path.open("rb") as file:
            hashes[path.relative_to(folder).as_posix()] = sha256(file.read()).hexdigest()
            os.fsync(file.fileno())
    sync_folder(folder)
    sync_folder(folder.parent)
    return hashes


def sync_folder(folder: Path) -> None:
    """Flush a folder's own entries."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _temporary(target: Path, data: bytes) -> Iterator[Path]:
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.parent / f"{TEMPORARY}{uuid4().hex}"
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
