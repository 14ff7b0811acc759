"""`doughnet predict`: one scene as the model sees it coming, as a page that opens anywhere."""

from pathlib import Path
from typing import Annotated, Any

import typer

from doughcli.net_options import SensorOption, ThreadsOption, WeightsOption, use_threads
from doughcli.options import DATASET_DEFAULT, DatasetOption, JsonOption, emit_json
from doughschemas import BadInputError

__all__ = ["command"]

NAME = "predict"
HELP = (
    "Predict a scene from its first view and the tool's motion, and save observation, prediction "
    "and truth side by side (.html). Of a recording every frame is reconstructed from its view."
)
EPILOG = "Example: doughnet predict --weights doughnet-run --scene 0 --save scene-0.html"


def command(
    save: Annotated[Path, typer.Option("--save", metavar="X.html", help="Where the page goes.")],
    dataset: DatasetOption = DATASET_DEFAULT,
    weights: WeightsOption = None,
    scene: Annotated[int, typer.Option(min=0, metavar="I", help="scene_index.")] = 0,
    sensor: SensorOption = "realsense",
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict, save the page, print its path."""
    if save.suffix.lower() != ".html" or not save.parent.is_dir():
        raise BadInputError(f"--save must name an .html file in a folder that exists, got {save}")
    use_threads(threads)
    from doughcli.net_page import save_prediction
    from doughdata.dataset import open_dataset
    from doughnet.predict import predict
    from doughnet.runs import find_weights
    from doughnet.weights import load_weights

    model = load_weights(find_weights(weights)).model
    with open_dataset(dataset) as source:
        if source.base_layer(scene) != "sim":
            sensor = "recorded"
        prediction = predict(model, source, scene=scene, sensor=sensor)
        definition = None if sensor == "recorded" else source.scene(scene)
    save_prediction(prediction, definition, save)
    found = [_frame(frame) for frame in prediction.frames]
    if as_json:
        emit_json({"page": str(save), "rolled_out": prediction.rolled_out, "frames": found})
        return
    for frame in found:
        truth = "" if frame["true_genus"] is None else f", true genus {frame['true_genus']}"
        print(f"key frame {frame['frame']}: genus {frame['genus']}{truth}")
    print(save.resolve())


def _frame(frame: Any) -> dict[str, Any]:
    true = frame.true_genus
    return {
        "frame": frame.frame_index,
        "genus": [genus for genus in frame.shape.genus if genus is not None],
        "true_genus": None if true is None else list(true),
    }
