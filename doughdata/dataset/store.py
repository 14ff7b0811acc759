"""Where a dataset lies, behind the few operations that the commit protocol needs; a folder is one.

`doughdata.dataset.remote` is the other: an object store.
"""

import errno
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Protocol, runtime_checkable
from uuid import uuid4

from doughschemas import DamagedDatasetError, DatasetError

__all__ = ["LocalStore", "Store", "explain_os_errors", "store_of"]

TEMPORARY = ".tmp-"  # prefix of what is not published yet, or is being removed
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
    """Files below one root; paths are relative and use `/`. Picklable, safe after fork and spawn.

    Every method raises DatasetError, in one line, when the store cannot be reached or refuses.
    """

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

    def read_range(self, path: str, start: int, stop: int | None = None) -> bytes:
        """Bytes start..stop-1, fewer at the file's end; a negative start counts from the end.

        Raises as `read` does.
        """
        ...

    def exists(self, path: str) -> bool:
        """Whether a file or folder is there."""
        ...

    def is_file(self, path: str) -> bool:
        """Whether a file, and not a folder, is there."""
        ...

    def names(self, folder: str) -> list[str]:
        """Sorted names directly in a folder; empty if it is missing."""
        ...

    def walk(self, folder: str) -> list[str]:
        """Sorted paths, relative to `folder`, of all files in it and below."""
        ...

    def modified(self, path: str) -> float:
        """When the newest file at or below a path was written [s since 1970], 0 if none is."""
        ...

    def create(self, path: str, data: bytes) -> bool:
        """Publish a file unless it exists; atomic and durable. False = it existed.

        After a lost connection False may mean that this very call had made it: compare contents.
        """
        ...

    def replace(self, path: str, data: bytes) -> None:
        """Write or overwrite a file; readers see the old or the new one, never a part."""
        ...

    def write_folder(self, folder: str, files: Mapping[str, bytes | Path]) -> None:
        """Write a new folder of files: name relative to it -> content, or a local file of it.

        Durable on return. A failure leaves nothing; a crash leaves files that no commit names.
        """
        ...

    def remove(self, path: str) -> None:
        """Delete a file or a folder with all that is in it; nothing happens if it is missing."""
        ...

    def local(self, path: str) -> Path:
        """Where a file is, or would be after `fetch`, on this machine."""
        ...

    def fetch(self, path: str) -> Path:
        """`local`, the file being there on return: a remote one is downloaded once."""
        ...


class LocalStore:
    """A folder on a local or mounted file system."""

    def __init__(self, uri: str | Path) -> None:
        self._uri = str(uri)
        self._root = Path(self._uri.removeprefix("file://")).absolute()
        self._prefix = f"{self._root}/"

    @property
    def uri(self) -> str:
        """The root, as the user wrote it."""
        return self._uri

    def read(self, path: str) -> bytes:
        """Whole file; see `Store.read`."""
        try:
            with FileIO(self._prefix + path) as file:
                return file.readall()
        except OSError as error:
            raise self._unreadable(path, error) from error

    def read_range(self, path: str, start: int, stop: int | None = None) -> bytes:
        """A part of a file; see `Store.read_range`. Holds nothing open."""
        try:  # no context manager: this is called eight times a frame
            handle = os.open(self._prefix + path, os.O_RDONLY)
            try:
                if start < 0 or stop is None:
                    size = os.fstat(handle).st_size
                    start, stop = max(0, start + size) if start < 0 else start, stop or size
                return os.pread(handle, stop - start, start)
            finally:
                os.close(handle)
        except OSError as error:
            raise self._unreadable(path, error) from error

    def exists(self, path: str) -> bool:
        """Whether a file or folder is there."""
        return self.local(path).exists()

    def is_file(self, path: str) -> bool:
        """Whether a file, and not a folder, is there."""
        return self.local(path).is_file()

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

    def modified(self, path: str) -> float:
        """When the newest file or folder at or below a path was written [s since 1970]."""
        root = self.local(path)
        times = []
        for place in (root, *root.rglob("*")):
            try:
                times.append(place.stat().st_mtime)
            except FileNotFoundError:  # another process removed it meanwhile
                continue
        return max(times, default=0.0)

    def create(self, path: str, data: bytes) -> bool:
        """Publish a file unless it exists: a hard link to a finished file never replaces."""
        target = self.local(path)
        with explain_os_errors(self._uri, f"write {path}"), _temporary(target, data) as temporary:
            try:
                os.link(temporary, target)
            except FileExistsError:
                return False
            _sync(target.parent)
        return True

    def replace(self, path: str, data: bytes) -> None:
        """Write or overwrite a file atomically."""
        target = self.local(path)
        with explain_os_errors(self._uri, f"write {path}"), _temporary(target, data) as temporary:
            temporary.replace(target)
            _sync(target.parent)

    def write_folder(self, folder: str, files: Mapping[str, bytes | Path]) -> None:
        """Write a new folder and flush its files, then all folders; a failure removes it."""
        root = self.local(folder)
        with explain_os_errors(self._uri, f"write {folder}"):
            root.mkdir(parents=True)
            try:
                for name, data in files.items():
                    path = root / name
                    path.parent.mkdir(parents=True, exist_ok=True)
                    _write_flushed(path, data)
                for place in (*(p for p in root.rglob("*") if p.is_dir()), root, root.parent):
                    _sync(place)
            except BaseException:
                shutil.rmtree(root, ignore_errors=True)
                raise

    def remove(self, path: str) -> None:
        """Delete; a folder is renamed first, so that a crash leaves no part under its name."""
        target = self.local(path)
        with explain_os_errors(self._uri, f"remove {path}"):
            if not target.is_dir():
                target.unlink(missing_ok=True)
                return
            doomed = target
            if not target.name.startswith(TEMPORARY):
                doomed = target.rename(target.parent / f"{TEMPORARY}{uuid4().hex}")
            shutil.rmtree(doomed)

    def local(self, path: str) -> Path:
        """Path on this machine."""
        return self._root / path if path else self._root

    def fetch(self, path: str) -> Path:
        """Path on this machine."""
        return self.local(path)

    def temporaries(self, folder: str) -> list[str]:
        """Paths of what crashes left unpublished below a folder."""
        return sorted(
            path.relative_to(self._root).as_posix()
            for path in self.local(folder).rglob(f"{TEMPORARY}*")
        )

    def _unreadable(self, path: str, error: OSError) -> DamagedDatasetError:
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            return DamagedDatasetError(f"{self._uri}: {path} is missing")
        return DamagedDatasetError(f"{self._uri}: cannot read {path}: {error.strerror}")


def store_of(uri: "str | Path | Store") -> Store:
    """The store behind a URI.

    Raises:
        DatasetError: a URI that this release cannot reach; the message names what works.
        MissingPackageError: the URI needs a package that is not installed.
    """
    if not isinstance(uri, str | Path):
        return uri
    scheme, separator, _ = str(uri).partition("://")
    if not separator or scheme == "file":
        return LocalStore(uri)
    from doughdata.dataset.remote import SCHEMES, RemoteStore

    if scheme not in SCHEMES:
        raise DatasetError(
            f"{uri}: {scheme}:// is not supported; give a local folder or one of "
            f"{', '.join(f'{name}://' for name in SCHEMES)}"
        )
    return RemoteStore(str(uri))


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


def _write_flushed(path: Path, data: bytes | Path) -> None:
    with path.open("wb") as file:
        if isinstance(data, Path):  # too large for memory
            with data.open("rb") as source:
                shutil.copyfileobj(source, file, 1 << 20)
        else:
            file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
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
        _write_flushed(temporary, data)
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
