"""`doughnet train`: the autoencoder, then the dynamics on its frozen codes."""

from pathlib import Path
from typing import Annotated

import typer

from doughcli.net_options import SensorOption, ShareBar, ThreadsOption, use_threads
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json

__all__ = ["command"]

NAME = "train"
HELP = (
    "Train a stage: first 'autoencoder', then 'dynamics' with the same --out; "
    "or 'gnn', a particle network to compare with."
)
EPILOG = (
    "Example: [cyan]doughnet train autoencoder --preset micro --minutes 30 --out net[/], then "
    "[cyan]doughnet train dynamics --minutes 30 --out net[/]"
)
DEFAULT_MINUTES = 60.0


def command(
    stage: Annotated[str, typer.Argument(metavar="STAGE", help="autoencoder, dynamics or gnn.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    preset: Annotated[
        str, typer.Option(metavar="P", help="micro, tiny, small, paper, or one with -classic.")
    ] = "small",
    recipe: Annotated[
        str,
        typer.Option(metavar="R", help="full, or one-step, explicit, relative, complete."),
    ] = "full",
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where weights and curves go.")
    ] = Path("doughnet-run"),
    minutes: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="M", help=f"How long (default: {DEFAULT_MINUTES:g})."),
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="How often all samples, instead.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the last checkpoint in --out.")
    ] = False,
    sensor: SensorOption = "realsense",
    batch_size: Annotated[int, typer.Option(min=1, metavar="B", help="Samples a step.")] = 8,
    workers: Annotated[int, typer.Option(min=0, metavar="N", help="Processes that read.")] = 1,
    balance: Annotated[
        bool, typer.Option(help="Draw rare topologies more often than they occur.")
    ] = True,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Of all random choices.")] = 0,
    learning_rate: Annotated[float, typer.Option(min=0.0, metavar="R", help="Highest.")] = 2e-3,
    accelerator: Annotated[str, typer.Option(metavar="A", help="auto, cpu or cuda.")] = "auto",
    devices: Annotated[int, typer.Option(min=1, metavar="N", help="GPUs or processes.")] = 1,
    precision: Annotated[str, typer.Option(metavar="P", help="32-true or bf16-mixed.")] = "32-true",
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Train and print where the weights are."""
    use_threads(threads)
    from doughnet.data import LoaderConfig
    from doughnet.optimisers import OptimiserConfig
    from doughnet.runs import RunConfig, train_stage
    from doughnet.train import TrainConfig, new_fabric

    fabric = new_fabric(accelerator=accelerator, devices=devices, precision=precision)
    config = RunConfig(
        dataset=dataset,
        out=out,
        preset=preset,
        recipe=recipe,
        sensor=sensor,
        minutes=DEFAULT_MINUTES if minutes is None and epochs is None else minutes,
        epochs=epochs,
        resume=resume,
        loader=LoaderConfig(batch_size=batch_size, workers=workers, seed=seed, balance=balance),
        train=TrainConfig(optimiser=OptimiserConfig(learning_rate=learning_rate), seed=seed),
    )
    with ShareBar(stage, quiet=as_json or not fabric.is_global_zero) as bar:
        fitted = train_stage(stage, config, fabric=fabric, listener=bar)
    if not fabric.is_global_zero:
        return
    folder = str(out / stage)
    if as_json:
        emit_json(
            {
                "weights": folder,
                "steps": fitted.step,
                "seconds": round(fitted.seconds, 1),
                **fitted.losses,
            }
        )
        return
    print(f"{fitted.step} steps in {fitted.seconds:.0f} s: {folder}")
