"""A dataset in an object store, reached through fsspec: `s3://bucket/folder`.

What the commit protocol asks of a store and an object store gives: a put is atomic and durable, and
a conditional put (`If-None-Match: *`, fsspec's `mode="create"`) never replaces an object.
"""

import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

from doughdata.registry import require_package
from doughschemas import DamagedDatasetError, DatasetError

__all__ = ["SCHEMES", "RemoteStore"]

SCHEMES = (
    "s3",
    "memory",
)  # create-if-absent is tested; memory:// ends with its process
CONNECT_SECONDS, ANSWER_SECONDS = 10, 60
TRIES = 4  # of a conditional put that S3 asks to come again
OPTIONS: dict[str, dict[str, Any]] = {  # beside what the environment says (AWS_*, FSSPEC_S3_*)
    "s3": {
        "use_listings_cache": False,
        "max_concurrency": 1,  # else every read asks for the size first
        "config_kwargs": {
            "retries": {"max_attempts": 2, "mode": "standard"},  # times five by s3fs, with pauses
            "connect_timeout": CONNECT_SECONDS,
            "read_timeout": ANSWER_SECONDS,
        },
    },
    "memory": {},
}


class RemoteStore:
    """Objects below a prefix. Holds no connection: every process opens its own when it first asks.

    A connection that was opened before a fork hangs the child, and one cannot be pickled.
    """

    def __init__(self, uri: str) -> None:
        self._uri = uri
        self._scheme, _, place = uri.partition("://")
        self._root = place.strip("/") if self._scheme == "s3" else "/" + place.strip("/")
        if not self._root.strip("/"):
            raise DatasetError(f"{uri}: name a bucket and a folder, for example s3://bucket/dough")
        if self._scheme == "s3":
            require_package("s3fs", extra="s3")
        self._opened: tuple[int, Any] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    @property
    def uri(self) -> str:
        """The root, as the user wrote it."""
        return self._uri

    def read(self, path: str) -> bytes:
        """Whole object; see `Store.read`."""
        with self._explain(f"read {path}", missing=path):
            return self._files.cat_file(self._key(path))

    def read_range(self, path: str, start: int, stop: int | None = None) -> bytes:
        """A part of an object, by one range request; see `Store.read_range`."""
        with self._explain(f"read {path}", missing=path):
            return self._files.cat_file(self._key(path), start=start, end=stop)

    def exists(self, path: str) -> bool:
        """Whether an object is there, or any below that prefix."""
        with self._explain(f"look for {path or 'it'}"):
            try:
                self._files.info(self._key(path))
            except FileNotFoundError as error:
                _refuse_missing_bucket(error)
                return False
            return True

    def is_file(self, path: str) -> bool:
        """Whether an object of exactly that name is there."""
        with self._explain(f"look for {path or 'it'}"):
            return self._files.isfile(self._key(path))

    def names(self, folder: str) -> list[str]:
        """Sorted names directly below a prefix; none if nothing is there."""
        with self._explain(f"list {folder}"):
            try:
                keys = self._files.ls(self._key(folder), detail=False)
            except FileNotFoundError as error:
                _refuse_missing_bucket(error)
                return []
        return sorted({key.rstrip("/").rpartition("/")[2] for key in keys})

    def walk(self, folder: str) -> list[str]:
        """Sorted names, relative to a prefix, of all objects below it."""
        with self._explain(f"list {folder}"):
            keys = self._files.find(self._key(folder))
        return sorted(key[len(self._key(folder)) + 1 :] for key in keys)

    def modified(self, path: str) -> float:
        """When the newest object at or below a path was written [s since 1970], 0 if none is."""
        with self._explain(f"look for {path}"):
            entries = self._files.find(self._key(path), detail=True).values()
        return max((_written(entry) for entry in entries), default=0.0)

    def create(self, path: str, data: bytes) -> bool:
        """Publish by a conditional put. False = the object existed (see `Store.create`)."""
        with self._explain(f"write {path}"):
            for attempt in range(TRIES):
                try:
                    self._files.pipe_file(self._key(path), data, mode="create")
                except FileExistsError:
                    return False
                except OSError as error:
                    code = _code(error)
                    if code in ("PreconditionFailed", "412"):
                        return False
                    # Two conditional puts at once: S3 asks one of them to come again.
                    if code not in ("ConditionalRequestConflict", "409") or attempt == TRIES - 1:
                        raise
                    time.sleep(0.1 * 2**attempt)
                else:
                    return True
        raise AssertionError("unreachable: the last try returns or raises")

    def replace(self, path: str, data: bytes) -> None:
        """Write or overwrite; a put is atomic."""
        with self._explain(f"write {path}"):
            self._files.pipe_file(self._key(path), data)

    def write_folder(self, folder: str, files: Mapping[str, bytes | Path]) -> None:
        """Upload files side by side; what is there already is removed again after a failure."""
        with self._explain(f"upload {folder}"):
            try:
                large = {k: data for k, data in files.items() if isinstance(data, Path)}
                small = {k: data for k, data in files.items() if isinstance(data, bytes)}
                self._files.pipe({self._key(f"{folder}/{k}"): data for k, data in small.items()})
                for name, file in large.items():
                    self._files.put_file(str(file), self._key(f"{folder}/{name}"))
            except BaseException:
                self._remove_quietly(folder)
                raise

    def remove(self, path: str) -> None:
        """Delete an object and all below that prefix."""
        with self._explain(f"remove {path}"):
            keys = self._files.find(self._key(path))
            if keys:
                self._files.rm(keys)

    def local(self, path: str) -> Path:
        """Where `fetch` keeps its copy: a folder of this user and dataset for temporary files."""
        user = os.getuid() if hasattr(os, "getuid") else 0
        root = Path(tempfile.gettempdir()) / f"doughdata-{user}"
        return root / f"{self._scheme}-{self._root.strip('/').replace('/', '-')}" / path

    def fetch(self, path: str) -> Path:
        """Download a file unless its copy is there; only for files that never change."""
        target = self.local(path)
        if not target.exists():
            data = self.read(path)
            target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            temporary = target.with_name(f".tmp-{uuid4().hex}")
            temporary.write_bytes(data)
            temporary.replace(target)
        return target

    def url(self, path: str) -> str:
        """Address of a file for other libraries."""
        return f"{self._scheme}://{self._key(path)}"

    @property
    def _files(self) -> Any:
        """This process's own connection."""
        if self._opened is None or self._opened[0] != os.getpid():
            import fsspec

            options = {**OPTIONS[self._scheme], "skip_instance_cache": True}
            self._opened = os.getpid(), fsspec.filesystem(self._scheme, **options)
        return self._opened[1]

    def _key(self, path: str) -> str:
        return f"{self._root}/{path}".rstrip("/")

    def _remove_quietly(self, folder: str) -> None:
        try:
            self.remove(folder)
        except Exception:  # the connection is gone: what is left is an orphan, `gc` finds it
            return

    @contextmanager
    def _explain(self, doing: str, *, missing: str | None = None) -> Iterator[None]:
        """Turn the errors of an object store into one line that says what to do."""
        try:
            yield
        except DatasetError:
            raise
        except FileNotFoundError as error:
            if missing is not None and _code(error) != "NoSuchBucket":
                raise DamagedDatasetError(f"{self._uri}: {missing} is missing") from error
            raise DatasetError(f"{self._uri}: cannot {doing}: {_advice(error)}") from error
        except _errors() as error:
            raise DatasetError(f"{self._uri}: cannot {doing}: {_advice(error)}") from error


def _written(entry: Mapping[str, Any]) -> float:
    """When an object was written, as the store's own listing tells it [s since 1970]."""
    time = entry.get("LastModified") or entry.get("created") or 0.0  # s3, memory
    return time.timestamp() if isinstance(time, datetime) else float(time)


def _errors() -> tuple[type[Exception], ...]:
    """What a connection may raise; botocore's errors are no OSError."""
    try:
        from aiohttp import ClientError as HttpError
        from botocore.exceptions import BotoCoreError, ClientError
    except ModuleNotFoundError:
        return (OSError,)
    return (OSError, BotoCoreError, ClientError, HttpError)


def _code(error: BaseException | None) -> str:
    """Error code of the S3 answer behind an error, or nothing."""
    while error is not None:
        response = getattr(error, "response", None)
        if isinstance(response, Mapping):
            return str(response.get("Error", {}).get("Code", ""))
        error = error.__cause__
    return ""


def _refuse_missing_bucket(error: FileNotFoundError) -> None:
    """Raise again if not the object but its bucket is missing."""
    if _code(error) == "NoSuchBucket":
        raise error


def _advice(error: Exception) -> str:
    """The reason, and what to do."""
    kind, code, text = type(error).__name__, _code(error), " ".join(str(error).split())
    if "Credentials" in kind:
        return (
            "no credentials were found; set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY "
            "(FSSPEC_S3_ANON=true reads public buckets without)"
        )
    if code == "NoSuchBucket":
        return "there is no such bucket; make it, or choose another --dataset"
    if isinstance(error, PermissionError):
        return f"access is denied ({code or text}); check the credentials and the bucket's policy"
    if isinstance(error, OSError) and code:
        return f"{text} ({code})"
    return (
        f"the connection failed ({text or kind}); what is committed is safe, "
        "the same command goes on"
    )
