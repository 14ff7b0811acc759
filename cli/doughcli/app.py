"""The `doughdata` command: wires the commands together and turns errors into one clear line."""

import errno
import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

import typer

from doughcli import (
    card,
    convert,
    export,
    gc,
    generate,
    info,
    merge,
    plugins,
    render,
    reproduce,
    scenes,
    split,
    stats,
    subset,
    validate,
    view,
)
from doughschemas import BadInputError, DoughError

__all__ = ["app", "main"]

DONE, FELL_SHORT, BAD_USAGE, INTERRUPTED = 0, 1, 2, 130

app = typer.Typer(
    name="doughdata",
    help="Simulated dough with ground-truth topology: make, render, check and look at datasets.",
    epilog="Start here: doughdata generate --scenes rolls, then doughdata render --noise realsense",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


class _InterruptedError(Exception):
    """Ctrl-C inside a command; typer would turn KeyboardInterrupt into a bare "Aborted"."""


def _interruptible(command: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(command)
    def run(*arguments: Any, **options: Any) -> Any:
        try:
            return command(*arguments, **options)
        except KeyboardInterrupt as error:
            raise _InterruptedError from error

    return run


COMMANDS = (
    *(generate, render, convert, validate, reproduce, info, stats, view, export, plugins),
    *(merge, subset, split, card),
    gc,
)
for module in COMMANDS:
    app.command(module.NAME, help=module.HELP, epilog=module.EPILOG)(_interruptible(module.command))
app.add_typer(scenes.app, name="scenes")


@app.callback(invoke_without_command=True)
def version_option(
    version: bool = typer.Option(False, "--version", help="Print the version and stop."),
) -> None:
    """Simulated dough with ground-truth topology: make, render, check and look at datasets."""
    if version:
        from doughdata import __version__

        print(__version__)
        raise typer.Exit


def main() -> None:
    """Entry point. Exit codes: 0 done, 1 something fell short, 2 bad usage, 130 interrupted."""
    try:
        app()
    except DoughError as error:
        _fail(str(error), BAD_USAGE if isinstance(error, BadInputError) else FELL_SHORT)
    except (_InterruptedError, KeyboardInterrupt):
        _fail("interrupted; what is committed is safe, the same command goes on", INTERRUPTED)
    except BrokenPipeError:
        os._exit(FELL_SHORT)  # the reader of a pipe went away; nothing left to say
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        hint = "free some space; what is committed is safe, the same command goes on"
        _fail(
            f"{error.strerror or error}: {error.filename or ''}".rstrip(": ")
            + (f"; {hint}" if full else "")
        )
    except Exception as error:  # the last net: a defect of ours, told in one line
        if os.environ.get("DOUGHDATA_TRACEBACK"):
            raise
        _fail(
            f"internal error, please report it: {type(error).__name__}: {error} "
            "(DOUGHDATA_TRACEBACK=1 shows where)"
        )


def _fail(message: str, code: int = FELL_SHORT) -> None:
    line = " ".join(message.split())
    print(f"doughdata: {line}", file=sys.stderr)
    sys.exit(code)
