"""Weights on disk: `weights.safetensors` beside `config.json`, which says where they come from."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from doughnet.config import config_from_json, config_to_json
from doughnet.extras import train_package
from doughnet.model import DoughNet
from doughschemas import BadInputError

__all__ = ["TENSORS", "Weights", "load_weights", "save_weights", "write_atomically"]

CONFIG, TENSORS = "config.json", "weights.safetensors"
FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """A model and what is known of its training."""

    model: DoughNet
    provenance: Mapping[str, Any] = field(default_factory=dict)


def save_weights(
    model: DoughNet,
    folder: Path,
    *,
    provenance: Mapping[str, Any],
    dtype: torch.dtype | None = None,
) -> None:
    """Write a model into a folder, each file whole or not at all.

    Args:
        model: on any device.
        folder: made if it is not there.
        provenance: JSON; preset, stages, dataset fingerprints, training configs.
        dtype: of the stored tensors, e.g. bfloat16 to ship them; None keeps the model's.
    """
    save = train_package("safetensors.torch").save
    state = model.state_dict()
    tensors = {name: value.to("cpu", dtype).contiguous() for name, value in state.items()}
    document = {"format": FORMAT, "model": config_to_json(model.config), **provenance}
    text = json.dumps(document, indent=2, allow_nan=False)
    folder.mkdir(parents=True, exist_ok=True)
    # The tensors carry the config as well: they alone suffice, and never belong to another one.
    write_atomically(folder / TENSORS, save(tensors, metadata={"config": text}))
    write_atomically(folder / CONFIG, text.encode() + b"\n")


def load_weights(folder: str | Path) -> Weights:
    """Read what `save_weights` wrote; the model computes in float32, ready to predict.

    Raises:
        BadInputError: no weights there, damaged ones, or ones of another model.
    """
    safetensors = train_package("safetensors")
    path = Path(folder)
    path = path / TENSORS if path.is_dir() else path
    if not path.is_file():
        raise BadInputError(
            f"{folder} holds no {TENSORS}; train a model with `doughnet train autoencoder`"
        )
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            document = json.loads((file.metadata() or {})["config"])
            state = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118
    except (safetensors.SafetensorError, KeyError, ValueError, OSError) as error:
        raise BadInputError(f"{path} is damaged or no weights of doughnet: {error}") from error
    if document.get("format") != FORMAT:
        raise BadInputError(
            f"{path} has format {document.get('format')}, this release reads {FORMAT}"
        )
    model = DoughNet(config_from_json(document["model"]))
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise BadInputError(f"{path} does not fit its own config: {error}") from error
    rest = {k: v for k, v in document.items() if k not in ("format", "model")}
    return Weights(model=model.eval().requires_grad_(False), provenance=rest)


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that after a crash it has the old content or the new one."""
    part = path.with_name(f".tmp-{os.getpid()}-{path.name}")
    try:
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
