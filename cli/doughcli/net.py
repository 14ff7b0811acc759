"""The `doughnet` command: train, evaluate and use the model."""

import typer

from doughcli import net_analyze, net_evaluate, net_plan, net_predict, net_train
from doughcli.running import interruptible, run

__all__ = ["app", "main"]

app = typer.Typer(
    name="doughnet",
    help="The model that predicts how dough deforms, splits, merges and gets holes.",
    epilog="Start here: doughnet train autoencoder --dataset dough-dataset --preset micro",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for module in (net_train, net_evaluate, net_predict, net_plan, net_analyze):
    app.command(module.NAME, help=module.HELP, epilog=module.EPILOG)(interruptible(module.command))


@app.callback(invoke_without_command=True)
def version_option(
    version: bool = typer.Option(False, "--version", help="Print the version and stop."),
) -> None:
    """The model that predicts how dough deforms, splits, merges and gets holes."""
    if version:
        from doughdata import __version__

        print(__version__)
        raise typer.Exit


def main() -> None:
    """Entry point."""
    run(app, name="doughnet", go_on="a training goes on with --resume")
