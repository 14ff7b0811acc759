"""Weights on disk: `weights.safetensors` beside `config.json`, which says where they come from."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from torch import nn

from doughnet.config import config_from_json
from doughnet.extras import train_package
from doughnet.model import DoughNet
from doughschemas import BadInputError

__all__ = [
    "TENSORS",
    "Configured",
    "Stored",
    "Weights",
    "load_weights",
    "read_weights",
    "save_weights",
    "write_atomically",
]

CONFIG, TENSORS = "config.json", "weights.safetensors"
FORMAT = 1
Model = TypeVar("Model", bound=nn.Module)


class Configured(Protocol):
    """A torch module that was made from a config, a dataclass of plain values."""

    config: Any

    def state_dict(self) -> dict[str, Any]:
        """Its tensors by name."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """A model and what is known of its training."""

    model: DoughNet
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """Tensors on disk and what they are of."""

    path: Path
    config: Mapping[str, Any]
    provenance: Mapping[str, Any]
    tensors: dict[str, torch.Tensor]  # float32

    def into(self, model: Model) -> Model:
        """A model of this config with these tensors, ready to predict.

        Raises:
            BadInputError: they do not fit.
        """
        try:
            model.load_state_dict(self.tensors)
        except RuntimeError as error:
            raise BadInputError(f"{self.path} does not fit its own config: {error}") from error
        return model.eval().requires_grad_(False)


def save_weights(
    model: Configured,
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
    document = {"format": FORMAT, "model": asdict(model.config), **provenance}
    text = json.dumps(document, indent=2, allow_nan=False)
    folder.mkdir(parents=True, exist_ok=True)
    # The tensors carry the config as well: they alone suffice, and never belong to another one.
    write_atomically(folder / TENSORS, save(tensors, metadata={"config": text}))
    write_atomically(folder / CONFIG, text.encode() + b"\n")


def load_weights(folder: str | Path) -> Weights:
    """Read what `save_weights` wrote of a DoughNet; it computes in float32, ready to predict.

    Raises:
        BadInputError: no weights there, damaged ones, or ones of another model.
    """
    stored = read_weights(folder)
    model = stored.into(DoughNet(config_from_json(stored.config)))
    return Weights(model=model, provenance=stored.provenance)


def read_weights(folder: str | Path, *, stage: str = "autoencoder") -> Stored:
    """Read what `save_weights` wrote, of whatever model.

    Raises:
        BadInputError: no weights there (train `stage`), or damaged ones.
    """
    safetensors = train_package("safetensors")
    path = Path(folder)
    path = path / TENSORS if path.is_dir() else path
    if not path.is_file():
        raise BadInputError(
            f"{folder} holds no {TENSORS}; train a model with `doughnet train {stage}`"
        )
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            document = json.loads((file.metadata() or {})["config"])
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118
            config = document["model"]
    except (safetensors.SafetensorError, KeyError, ValueError, OSError) as error:
        raise BadInputError(f"{path} is damaged or no weights of doughnet: {error}") from error
    if document.get("format") != FORMAT:
        raise BadInputError(
            f"{path} has format {document.get('format')}, this release reads {FORMAT}"
        )
    rest = {k: v for k, v in document.items() if k not in ("format", "model")}
    return Stored(path=path, config=config, provenance=rest, tensors=tensors)


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
