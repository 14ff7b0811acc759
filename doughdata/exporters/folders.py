"""Output that appears whole or not at all."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from doughschemas import BadInputError

__all__ = ["new_file", "new_folder"]


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which becomes `out` at the end; a failure leaves nothing.

    Raises:
        BadInputError: `out` is a file or a folder with something in it, or cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BadInputError(f"{out} is there already; give --out a new or empty folder")
    with _moved(out) as temporary:
        temporary.mkdir(parents=True)
        yield temporary
        if out.is_dir():
            out.rmdir()


@contextmanager
def new_file(out: Path) -> Iterator[Path]:
    """A path to write, which becomes `out` at the end; a failure leaves what was there.

    Raises:
        BadInputError: `out` is a folder, or cannot be written.
    """
    if out.is_dir():
        raise BadInputError(f"{out} is a folder; give --out a file")
    with _moved(out) as temporary:
        yield temporary


@contextmanager
def _moved(out: Path) -> Iterator[Path]:
    temporary = out.parent / f".{out.name}-{uuid4().hex[:8]}"
    try:
        yield temporary
        temporary.replace(out)
    except OSError as error:
        raise BadInputError(f"cannot write {out}: {error.strerror or error}") from error
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
