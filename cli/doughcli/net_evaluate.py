"""`doughnet evaluate`: the table of shapes and topologies, reconstructed and predicted."""

from pathlib import Path
from typing import Annotated, Any

import typer

from doughcli.net_options import (
    SensorOption,
    ShareBar,
    ThreadsOption,
    WeightsOption,
    use_threads,
)
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json
from doughschemas import BadInputError, UnknownNameError

__all__ = ["command"]

NAME = "evaluate"
HELP = "Score a model on the test split: VIoU, CIoU, AccC, AccG at 1 mm, per frame, in percent."
EPILOG = "Example: doughnet evaluate --weights doughnet-run --dataset dough-dataset --json"
ROWS = ("reconstruction", "ceiling", "single_step", "full_sequence", "final", "copy_first_frame")
METHODS = ("doughnet", "vpm", "mpm", "gnn", "copy")
COLUMNS = ("viou", "ciou", "accc", "accg", "balanced_accg")


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    weights: WeightsOption = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="M",
            help="doughnet; or vpm, mpm, gnn, copy: full sequences predicted another way.",
        ),
    ] = "doughnet",
    split: Annotated[str, typer.Option(metavar="S", help="test, train or all.")] = "test",
    sensor: SensorOption = "realsense",
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the table."""
    if split not in ("test", "train", "all"):
        raise BadInputError(f"split must be test, train or all, got {split!r}")
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    use_threads(threads)
    from doughdata.dataset import open_dataset
    from doughdata.torch import DoughSequences
    from doughnet.baselines.methods import evaluate_method
    from doughnet.data import key_frames
    from doughnet.evaluate import evaluate
    from doughnet.runs import find_weights
    from doughnet.weights import load_weights

    folder = find_weights(weights)
    loaded = load_weights(folder)

    frames = key_frames(open_dataset(dataset), sensor)
    sequences = DoughSequences(
        dataset,
        length=None,
        frames=frames,
        sensor=sensor,
        split=None if split == "all" else split,
        num_queries=1,
    )
    with ShareBar("evaluate", quiet=as_json) as bar:

        def progress(done: int, every: int) -> None:
            bar.advance(done / every)

        if method == "doughnet":
            table = evaluate(loaded.model, sequences, progress=progress)
        else:
            made = _method(method, loaded.model, sequences, folder)
            table = evaluate_method(made, sequences, progress=progress)
    table = {"dataset": dataset, "weights": str(folder), "split": split, **table}
    if as_json:
        emit_json(table)
    elif method == "doughnet":
        _print(table)
    else:
        _print_method(table)


def _method(name: str, model: Any, sequences: Any, folder: Path) -> Any:
    from doughcli.net_player import ScenePlayer, dough_around
    from doughnet.baselines.gnn import Gnn, load_particle_net
    from doughnet.baselines.methods import Copy, Vpm
    from doughnet.baselines.simulated import Simulated

    if name == "mpm":
        return Simulated(model, ScenePlayer(sequences.source))
    if name == "gnn":
        return Gnn(model, load_particle_net(folder), dough_around)
    return Vpm(model) if name == "vpm" else Copy()


def _print_method(table: dict[str, Any]) -> None:
    failed = f", {table['failed']} of them failed" if table["failed"] else ""
    print(f"{table['method']}: {table['scenes']} scenes{failed}; {table['fps']} frames/s; percent")
    print(f"{'':16}" + "".join(f"{name:>22}" for name in COLUMNS))
    for name in ("full_sequence", "final"):
        row = table[name]
        cells = (
            f"{row[c]:.1f} [{row['interval'][c][0]:.1f}, {row['interval'][c][1]:.1f}]"
            for c in COLUMNS
        )
        print(f"{name:16}" + "".join(f"{cell:>22}" for cell in cells))


def _print(table: dict[str, Any]) -> None:
    print(f"{table['scenes']} scenes; percent, mean over frames")
    print(f"{'':26}" + "".join(f"{name:>15}" for name in COLUMNS))
    rows = [(name, table[name]) for name in ROWS if name in table]
    rows += [(f"{name}, unlabelled", row) for name, row in table["unlabelled"].items()]
    for name, row in rows:
        print(f"{name:26}" + "".join(f"{row[column]:15.1f}" for column in COLUMNS))
    print(f"frames in which masks and genus head disagree: {table['inconsistent']}")
