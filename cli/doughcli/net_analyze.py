"""`doughnet analyze`: where latents lie, when they jump, which frames go wrong and how."""

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
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "analyze"
HELP = (
    "Draw t-SNE of the latents, find topological changes by their jumps (render --all-frames for "
    "that), errors step by step, failures, and the scales of bodies and tools."
)
EPILOG = "Example: doughnet analyze --dataset dough-dataset --weights doughnet-run --save analysis"
SHOWN_FAILURES = 12


def command(
    dataset: DatasetOption = DATASET_DEFAULT,
    weights: WeightsOption = None,
    split: Annotated[str, typer.Option(metavar="S", help="test, train or all.")] = "test",
    sensor: SensorOption = "realsense",
    save: Annotated[
        Path, typer.Option("--save", metavar="DIR", help="Folder for pictures and analysis.json.")
    ] = Path("doughnet-analysis"),
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure, draw, print."""
    if split not in ("test", "train", "all"):
        raise BadInputError(f"split must be test, train or all, got {split!r}")
    use_threads(threads)
    from doughcli.net_charts import Charts
    from doughdata.dataset import open_dataset
    from doughdata.torch import DoughSequences
    from doughdata.torch.views import choose_views
    from doughnet.analysis.changes import detector, jump_scores
    from doughnet.analysis.embedding import embed
    from doughnet.analysis.errors import sequence_errors
    from doughnet.analysis.latents import scene_latents
    from doughnet.data import key_frames
    from doughnet.runs import find_weights
    from doughnet.weights import load_weights

    model = load_weights(find_weights(weights)).model
    source = open_dataset(dataset)
    wanted = None if split == "all" else split
    sequences = DoughSequences(
        dataset, length=None, frames=key_frames(source, sensor), sensor=sensor, split=wanted,
        num_queries=1,
    )  # fmt: skip
    views = choose_views(source, sensor, split=wanted, frames=None)
    scenes = sorted(set(views[:, 0].tolist()))
    charts = Charts(save)
    with ShareBar("analyze", quiet=as_json) as bar:
        latents = scene_latents(
            model, source, scenes=scenes, sensor=sensor,
            progress=lambda done, every: bar.advance(done / every / 2),
        )  # fmt: skip
        errors = sequence_errors(
            model, sequences, progress=lambda done, every: bar.advance(0.5 + done / every / 2)
        )
    scores = [jump_scores(own.mean) for own in latents]
    found: dict[str, Any] = {"scenes": len(scenes), "split": split}
    try:
        changes = detector(scores, [own.changed for own in latents])
    except BadInputError as error:
        found["changes"] = {"not_measured": str(error)}
    else:
        charts.curves(changes)
        found["changes"] = {
            "f1": round(changes.f1, 2),
            "threshold": round(changes.threshold, 3),
            "area": round(changes.area, 4),
            "positive_rate": round(changes.positive_rate, 2),
            "key_frames": max(len(own.frames) for own in latents),
        }
    places = embed(_stacked(latents))
    charts.embedding(places, latents)
    charts.errors(errors)
    charts.scales(source)
    found |= {
        "by_step": list(errors.by_step),
        "first_wrong": errors.first_wrong,
        "corrected": [round(value, 2) for value in errors.corrected],
        "inconsistent_percent": round(errors.inconsistent, 2),
        "failures": len(errors.failures),
        "worst": [
            {
                "scene": one.scene_index,
                "frame": one.frame_index,
                "viou": round(100 * one.volume_iou, 2),
                "predicted": list(one.predicted),
                "true": list(one.true),
                "inconsistent": one.inconsistent,
            }
            for one in errors.failures[:SHOWN_FAILURES]
        ],
    }
    charts.failures(model, sequences, errors.failures[:SHOWN_FAILURES])
    charts.write_json(found)
    if as_json:
        emit_json({"folder": str(save), **found})
        return
    if "f1" in found["changes"]:
        print(f"changes: F1 {found['changes']['f1']} at z {found['changes']['threshold']}")
    else:
        print(f"changes: not measured, {found['changes']['not_measured']}")
    print(
        f"{found['failures']} frames with a wrong topology, masks and genus head disagree in "
        f"{found['inconsistent_percent']} %"
    )
    print(save.resolve())


def _stacked(latents: Any) -> Any:
    import numpy as np

    if not latents:
        raise BadInputError("no scene has two rendered key frames; `doughdata render --all-frames`")
    return np.concatenate([own.mean for own in latents])
