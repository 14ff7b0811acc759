"""Does the model learn? A small one, trained for minutes on shapes whose occupancy is a formula."""

import time
from dataclasses import dataclass
from typing import Any

import torch

from doughnet.augment import Augmentation
from doughnet.config import ModelConfig, micro
from doughnet.lattice import Lattice
from doughnet.metrics import TopologyScore, score
from doughnet.model import DoughNet
from doughnet.optimisers import OptimiserConfig
from doughnet.procedural import BOX, Shapes, random_shapes, sample_batch, stream
from doughnet.stages import AutoencoderStage
from doughnet.train import Budget, Listener, TrainConfig, fit

__all__ = ["GateResult", "held_out_scores", "train_and_score"]

HELD_OUT_SEED = 2**31  # no training batch draws from it
BATCH_SIZE = 8
# Every batch has new shapes in new places; only the names of components must not be learned.
NEW_ANYWAY = Augmentation(turn=0.0, point_dropout=0.0, label_dropout=0.0)
GATE_TRAINING = TrainConfig(optimiser=OptimiserConfig(learning_rate=2e-3))


@dataclass(frozen=True, slots=True, kw_only=True)
class GateResult:
    """Percentages over the held-out shapes, and what the training took."""

    viou: float
    ciou: float
    accc: float
    accg: float
    steps: int
    cpu_seconds: float
    loss: float


def train_and_score(
    budget: Budget,
    *,
    model_config: ModelConfig | None = None,
    config: TrainConfig | None = None,
    held_out: int = 48,
    listener: Listener | None = None,
) -> GateResult:
    """Train on endless procedural shapes, then score on others."""
    config = config or GATE_TRAINING
    torch.manual_seed(config.seed)
    stage = AutoencoderStage(DoughNet(model_config or micro()), augmentation=NEW_ANYWAY)
    started = time.process_time()
    fitted = fit(
        stage,
        lambda step: stream(config.seed, batch_size=BATCH_SIZE, step=step),
        budget,
        config=config,
        listener=listener,
    )
    seconds = time.process_time() - started
    found = held_out_scores(stage.model, count=held_out)
    means = {
        "viou": [one.volume_iou for one in found],
        "ciou": [one.component_iou for one in found],
        "accc": [one.right_count for one in found],
        "accg": [one.right_genus for one in found],
    }
    percent = {name: round(100 * sum(v) / len(v), 2) for name, v in means.items()}
    return GateResult(
        **percent,
        steps=fitted.step,
        cpu_seconds=round(seconds, 1),
        loss=round(fitted.losses["loss"], 5),
    )


@torch.inference_mode()
def held_out_scores(model: DoughNet, *, count: int) -> list[TopologyScore]:
    """Scores of reconstructions from single views, at 1 mm, on shapes that are new to the model."""
    rng = torch.Generator().manual_seed(HELD_OUT_SEED)
    shapes = random_shapes(count, rng)
    batch = sample_batch(shapes, rng)
    latents = model.eval().encode(batch["points"], batch["point_labels"])
    lattice = _lattice()
    points = lattice.points(torch.arange(lattice.count))
    scores = []
    for index in range(count):
        shape = model.decode(latents[index], lattice)
        true = _one(shapes, index).labels(points[None])[0]
        genus = [g for g in shapes.genus[index].tolist() if g >= 0]
        labels, found = shape.components()
        scores.append(score(labels.flatten(), true, predicted_genus=found, true_genus=genus))
    return scores


def _lattice() -> Lattice:
    low, high = (torch.tensor(corner) * 1000 for corner in BOX)
    first, shape = low.round().int().tolist(), (high - low).round().int().add(1).tolist()
    return Lattice(
        first=(first[0], first[1], first[2]), shape=(shape[0], shape[1], shape[2]), spacing=1e-3
    )


def _one(shapes: Shapes, index: int) -> Shapes:
    def part(values: Any) -> Any:
        return values[index : index + 1]

    return Shapes(
        kind=part(shapes.kind),
        size=part(shapes.size),
        centre=part(shapes.centre),
        yaw=part(shapes.yaw),
        present=part(shapes.present),
    )
