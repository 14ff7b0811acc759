"""The stages from a dataset to a folder of weights, as the commands run them.

OUT/autoencoder, OUT/dynamics and OUT/gnn (a baseline) hold what each stage leaves:
weights.safetensors with config.json, training.pt (to resume), metrics.csv and tensorboard/.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from doughdata.dataset import open_dataset
from doughdata.torch import DoughDataset, DoughSequences
from doughdata.torch.views import COMPLETE
from doughnet.baselines.particle_data import ParticleWindows
from doughnet.baselines.particle_net import ParticleConfig, ParticleNet
from doughnet.baselines.particle_stage import ParticleStage
from doughnet.config import preset
from doughnet.data import (
    EndlessBatches,
    LoaderConfig,
    PlacedSamples,
    Samples,
    balancing,
    class_weights,
    key_frames,
)
from doughnet.model import DoughNet
from doughnet.recipes import recipe
from doughnet.stages import AutoencoderStage, DynamicsStage, Stage
from doughnet.train import STATE, Budget, Fitted, Listener, TrainConfig, fit
from doughnet.weights import TENSORS, load_weights
from doughschemas import BadInputError, UnknownNameError

__all__ = ["MODEL_STAGES", "STAGES", "RunConfig", "find_weights", "train_stage"]

MODEL_STAGES = ("autoencoder", "dynamics")
STAGES = (*MODEL_STAGES, "gnn")
PRETRAINED = Path(__file__).parent / "pretrained"  # one folder a preset; a wheel carries it
SHIPPED = ("small", "tiny", "micro")  # the first that is there is the default


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """What a training reads, writes and how long it may take; `minutes` or `epochs`."""

    dataset: str
    out: Path
    preset: str = "small"
    recipe: str = "full"
    sensor: str = "realsense"
    split: str = "train"
    minutes: float | None = None
    epochs: int | None = None
    resume: bool = False
    loader: LoaderConfig = field(default_factory=LoaderConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


def train_stage(
    name: str, config: RunConfig, *, fabric: Any, listener: Listener | None = None
) -> Fitted:
    """Train one stage of a model on a dataset.

    Raises:
        UnknownNameError: no such stage or preset.
        BadInputError: `out` holds a training already and it is not to be resumed; the dynamics
            have no trained autoencoder to start from; not exactly one of minutes and epochs.
        MissingLayerError: the dataset has no depth of that sensor.
    """
    if name not in STAGES:
        raise UnknownNameError("stage", name, STAGES)
    if (config.minutes is None) == (config.epochs is None):
        raise BadInputError("give either minutes or epochs")
    out = config.out / name
    if (out / STATE).exists() and not config.resume:
        raise BadInputError(f"{out} holds a training: --resume goes on, or give another --out")
    torch.manual_seed(config.train.seed)
    if name == "gnn":
        particles, windows, stepped = _particles(config)
        return _fit(particles, windows, stepped, None, {}, config, fabric, listener)
    model, before = _model(name, config)
    how = recipe(config.recipe)
    sensor = COMPLETE if how.complete else config.sensor
    common: dict[str, Any] = {
        "sensor": sensor,
        "split": config.split,
        "seed": config.loader.seed,
    }
    views = DoughDataset(config.dataset, **common)  # every view that was rendered
    data: PlacedSamples = views
    if name == "dynamics":
        frames = key_frames(data.source, sensor)
        data = _sequences(config.dataset, frames, common, length=1 + how.steps)
    drawn = balancing(data) if config.loader.balance else None
    weights = class_weights(data, model.config, drawn)
    if name == "autoencoder":
        stage: Stage = AutoencoderStage(model, class_weights=weights)
    else:
        stage = DynamicsStage(model, class_weights=weights, explicit=how.explicit)
    return _fit(stage, data, views.rendered_frames, drawn, before, config, fabric, listener)


def _fit(
    stage: Stage,
    data: Samples,
    frames: tuple[int, ...],
    drawn: Float64[np.ndarray, " samples"] | None,
    before: Mapping[str, Any],
    config: RunConfig,
    fabric: Any,
    listener: Listener | None,
) -> Fitted:
    batches = EndlessBatches(
        data,
        config.loader,
        weights=drawn,
        rank=fabric.global_rank,
        world_size=fabric.world_size,
    )
    return fit(
        stage,
        batches,
        _budget(config, len(data) // fabric.world_size),
        config=config.train,
        fabric=fabric,
        out=config.out / stage.name,
        resume=config.resume,
        provenance=_provenance(stage.name, config, data, frames, before),
        listener=listener,
    )


def _particles(config: RunConfig) -> tuple[Stage, Samples, tuple[int, ...]]:
    """The baseline's network and its windows of tracked particles."""
    with open_dataset(config.dataset) as source:
        frames = key_frames(source, COMPLETE)
    sizes = ParticleConfig()
    data = ParticleWindows(
        config.dataset, config=sizes, frames=frames, split=config.split, seed=config.loader.seed
    )
    return ParticleStage(ParticleNet(sizes)), data, frames


def find_weights(folder: str | Path | None = None) -> Path:
    """The last stage's weights in what a training left, or the folder itself; None = the shipped.

    Raises:
        BadInputError: there are none.
    """
    if folder is None:
        for name in SHIPPED:
            if (PRETRAINED / name / TENSORS).is_file():
                return PRETRAINED / name
        raise BadInputError(
            "this release ships no trained weights yet; train a model with `doughnet train "
            "autoencoder`, then `dynamics`, and give its folder as --weights DIR"
        )
    path = Path(folder)
    for candidate in (path, path / "dynamics", path / "autoencoder"):
        if (candidate / TENSORS).is_file():
            return candidate
    raise BadInputError(
        f"{folder} holds no weights; train a model with `doughnet train autoencoder --out {folder}`"
    )


def _model(name: str, config: RunConfig) -> tuple[DoughNet, dict[str, Any]]:
    """A new model, or for the dynamics the one whose autoencoder was trained.

    A recipe with other dynamics finds an autoencoder that was trained for all of them.
    """
    relative = recipe(config.recipe).relative
    if name == "autoencoder":
        return DoughNet(replace(preset(config.preset), relative=relative)), {}
    folder = config.out / "autoencoder"
    if not folder.is_dir():
        raise BadInputError(
            f"{config.out} holds no trained autoencoder; begin with "
            f"`doughnet train autoencoder --out {config.out}`"
        )
    weights = load_weights(folder)
    model = DoughNet(replace(weights.model.config, relative=relative))
    model.autoencoder.load_state_dict(weights.model.autoencoder.state_dict())
    return model, {"autoencoder": dict(weights.provenance)}


def _sequences(
    uri: str, frames: tuple[int, ...], common: Mapping[str, Any], *, length: int
) -> DoughSequences:
    """Windows as far apart as the model's key frames, from every rendered key frame on."""
    step = frames[1] - frames[0] if len(frames) > 1 else 1
    if len(frames) < length:
        raise BadInputError(
            f"{uri}: dynamics need {length} key frames of a scene, {len(frames)} were rendered; "
            "render more with `doughdata render --all-frames`"
        )
    source = DoughDataset(uri, **common)
    every = source.rendered_frames
    dense = every == tuple(range(every[0], every[-1] + 1))
    chosen = {"frames": every, "stride": step} if dense else {"frames": frames}
    return DoughSequences(uri, length=length, **chosen, **common)


def _budget(config: RunConfig, samples: int) -> Budget:
    if config.epochs is not None:
        return Budget(steps=config.epochs * max(1, samples // config.loader.batch_size))
    return Budget(seconds=60 * (config.minutes or 0.0))


def _provenance(
    name: str,
    config: RunConfig,
    data: Samples,
    frames: tuple[int, ...],
    before: Mapping[str, Any],
) -> dict[str, Any]:
    """What is written beside the weights: enough to train them again."""
    return {
        "preset": before["autoencoder"]["preset"] if name == "dynamics" else config.preset,
        "stage": name,
        "recipe": config.recipe,
        "data": {
            "fingerprint": data.source.fingerprint,
            "sensor": data.sensor,
            "split": config.split,
            "frames": list(frames),
            "samples": len(data),
        },
        "budget": {"minutes": config.minutes, "epochs": config.epochs},
        "batch_size": config.loader.batch_size,
        "balance": config.loader.balance and name in MODEL_STAGES,
        "train": asdict(config.train),
        **before,
    }
