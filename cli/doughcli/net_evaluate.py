"""`doughnet evaluate`: the table of shapes and topologies, reconstructed and predicted."""

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
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "evaluate"
HELP = "Score a model on the test split: VIoU, CIoU, AccC, AccG at 1 mm, per frame, in percent."
EPILOG = "Example: doughnet evaluate --weights doughnet-run --dataset dough-dataset --json"
ROWS = ("reconstruction", "ceiling", "single_step", "full_sequence", "final", "copy_first_frame")
COLUMNS = ("viou", "ciou", "accc", "accg", "balanced_accg")


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    weights: WeightsOption = None,
    split: Annotated[str, typer.Option(metavar="S", help="test, train or all.")] = "test",
    sensor: SensorOption = "realsense",
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the table."""
    if split not in ("test", "train", "all"):
        raise BadInputError(f"split must be test, train or all, got {split!r}")
    use_threads(threads)
    from doughdata.torch import DoughSequences
    from doughnet.data import key_frames
    from doughnet.evaluate import evaluate
    from doughnet.runs import find_weights
    from doughnet.weights import load_weights

    folder = find_weights(weights)
    loaded = load_weights(folder)
    from doughdata.dataset import open_dataset

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
        table = evaluate(
            loaded.model, sequences, progress=lambda done, every: bar.advance(done / every)
        )
    table = {"dataset": dataset, "weights": str(folder), "split": split, **table}
    if as_json:
        emit_json(table)
    else:
        _print(table)


def _print(table: dict[str, Any]) -> None:
    print(f"{table['scenes']} scenes; percent, mean over frames")
    print(f"{'':26}" + "".join(f"{name:>15}" for name in COLUMNS))
    rows = [(name, table[name]) for name in ROWS if name in table]
    rows += [(f"{name}, unlabelled", row) for name, row in table["unlabelled"].items()]
    for name, row in rows:
        print(f"{name:26}" + "".join(f"{row[column]:15.1f}" for column in COLUMNS))
    print(f"frames in which masks and genus head disagree: {table['inconsistent']}")
