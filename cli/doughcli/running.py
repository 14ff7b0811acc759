"""How every program of this project ends: a result, or one clear line and an exit code."""

import errno
import os
import sys
import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any

from doughschemas import BadInputError, DoughError

__all__ = ["BAD_USAGE", "DONE", "FELL_SHORT", "INTERRUPTED", "interruptible", "run"]

DONE, FELL_SHORT, BAD_USAGE, INTERRUPTED = 0, 1, 2, 130


class _InterruptedError(Exception):
    """Ctrl-C inside a command; typer would turn KeyboardInterrupt into a bare "Aborted"."""


def interruptible(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command whose Ctrl-C reaches `run`."""

    @wraps(command)
    def wrapped(*arguments: Any, **options: Any) -> Any:
        try:
            return command(*arguments, **options)
        except KeyboardInterrupt as error:
            raise _InterruptedError from error

    return wrapped


def run(program: Callable[[], Any], *, name: str, go_on: str = "the same command goes on") -> None:
    """Run a program. Exit codes: 0 done, 1 something fell short, 2 bad usage, 130 interrupted.

    `go_on` tells how to take up interrupted work.
    """
    warnings.showwarning = lambda message, *_: print(f"{name}: {message}", file=sys.stderr)
    try:
        program()
    except DoughError as error:
        _fail(name, str(error), BAD_USAGE if isinstance(error, BadInputError) else FELL_SHORT)
    except (_InterruptedError, KeyboardInterrupt):
        _fail(name, f"interrupted; what is saved is safe, {go_on}", INTERRUPTED)
    except BrokenPipeError:
        os._exit(FELL_SHORT)  # the reader of a pipe went away; nothing left to say
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        hint = f"; free some space, {go_on}" if full else ""
        _fail(name, f"{error.strerror or error}: {error.filename or ''}".rstrip(": ") + hint)
    except Exception as error:  # the last net: a defect of ours, told in one line
        if os.environ.get("DOUGHDATA_TRACEBACK"):
            raise
        _fail(
            name,
            f"internal error, please report it: {type(error).__name__}: {error} "
            "(DOUGHDATA_TRACEBACK=1 shows where)",
        )


def _fail(name: str, message: str, code: int = FELL_SHORT) -> None:
    print(f"{name}: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)
