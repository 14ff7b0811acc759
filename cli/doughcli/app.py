"""The `doughdata` command: wires the commands together and turns errors into one clear line."""

import typer

from doughcli import (
    card,
    convert,
    export,
    gc,
    generate,
    info,
    merge,
    migrate,
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
from doughcli.running import interruptible, run

__all__ = ["app", "main"]

app = typer.Typer(
    name="doughdata",
    help="Simulated dough with ground-truth topology: make, render, check and look at datasets.",
    epilog="Start here: doughdata generate --scenes rolls, then doughdata render --noise realsense",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


COMMANDS = (
    *(generate, render, convert, validate, reproduce, info, stats, view, export, plugins),
    *(merge, subset, split, migrate, card, gc),
)
for module in COMMANDS:
    app.command(module.NAME, help=module.HELP, epilog=module.EPILOG)(interruptible(module.command))
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
    """Entry point; `running.run` names the exit codes."""
    run(app, name="doughdata")
