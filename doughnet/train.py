"""The training loop: steps until the budget is spent, checkpoints on the way, resumes exactly.

Everything random in a step is drawn from (seed, step), and batches are served from any step on.
So a run that was killed and resumed gives the same weights, bit for bit, at one thread.
"""

import io
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import nn
from torch.optim import Optimizer

from doughdata.seeds import seed_sequence
from doughnet.averaging import WeightAverage
from doughnet.extras import train_package
from doughnet.journal import Journal
from doughnet.optimisers import OptimiserConfig, learning_rate, optimisers, set_learning_rate
from doughnet.stages import Batch, Stage
from doughnet.weights import save_weights, write_atomically
from doughschemas import BadInputError

__all__ = ["Budget", "Fitted", "Listener", "Silent", "TrainConfig", "fit", "new_fabric"]

STATE = "training.pt"
Batches = Callable[[int], Iterator[Batch]]  # from a step on, without end


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """How long to train: a number of steps, or seconds of a clock."""

    steps: int | None = None
    seconds: float | None = None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.seconds is None):
            raise BadInputError("give either a number of steps (or epochs) or a time to train")

    def progress(self, step: int, seconds: float) -> float:
        """Share of the budget that is spent; 1 or more = all."""
        if self.steps is not None:
            return step / max(self.steps, 1)
        return seconds / max(self.seconds or 0.0, 1e-9)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """How a stage is trained."""

    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    average_decay: float = 0.999
    clip: float = 1.0  # longest gradient
    seed: int = 0
    checkpoint_seconds: float = 120.0
    record_every: int = 20  # steps


class Listener(Protocol):
    """Hears how the training goes."""

    def advance(self, progress: float, values: dict[str, float]) -> None:
        """A share of the budget is spent; the latest losses."""
        ...


class Silent:
    """Hears and says nothing."""

    def advance(self, progress: float, values: dict[str, float]) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """How a training ended."""

    step: int
    seconds: float
    losses: dict[str, float]


def new_fabric(*, accelerator: str = "auto", devices: int | str = 1, precision: str = "32") -> Any:
    """Lightning Fabric for a CPU, one GPU or several; started at once.

    Raises:
        MissingPackageError: the extra `train` is not installed.
    """
    fabric = train_package("lightning_fabric").Fabric
    found = fabric(accelerator=accelerator, devices=devices, precision=precision)
    found.launch()
    return found


def fit(
    stage: Stage,
    batches: Batches,
    budget: Budget,
    *,
    config: TrainConfig,
    fabric: Any = None,
    out: Path | None = None,
    resume: bool = False,
    provenance: dict[str, Any] | None = None,
    listener: Listener | None = None,
) -> Fitted:
    """Train a stage until its budget is spent; its model then has the averaged weights.

    Args:
        stage: what is trained.
        batches: batches from a step on, without end.
        budget: when to stop.
        config: how.
        fabric: devices; by default the CPU of this process.
        out: folder of weights, checkpoint and journal; None keeps nothing.
        resume: go on from the checkpoint in `out`, if there is one.
        provenance: written beside the weights.
        listener: hears of the progress.

    Raises:
        BadInputError: the checkpoint is of another stage, model or configuration.
    """
    run = _Run(
        stage, budget, config, fabric or new_fabric(accelerator="cpu"), out, provenance or {}
    )
    if resume:
        run.restore()
    journal = Journal(out, step=run.step) if out is not None and run.fabric.is_global_zero else None
    try:
        run.train(batches, journal, listener or Silent())
    finally:
        if journal is not None:
            journal.close()
    return Fitted(step=run.step, seconds=run.seconds, losses=run.losses)


class _Run:
    """State of one training; what `training.pt` holds."""

    def __init__(
        self,
        stage: Stage,
        budget: Budget,
        config: TrainConfig,
        fabric: Any,
        out: Path | None,
        provenance: dict[str, Any],
    ) -> None:
        if not isinstance(stage, nn.Module):
            raise BadInputError(f"a stage must be a torch module, got {type(stage).__name__}")
        self.stage, self.budget, self.config = stage, budget, config
        self.fabric, self.out, self.provenance = fabric, out, provenance
        self.step, self.seconds, self.losses = 0, 0.0, dict[str, float]()
        made = optimisers(stage, config.optimiser)
        self.module, *self.optimisers = fabric.setup(stage, *made)
        self.average = WeightAverage(stage, decay=config.average_decay)

    def train(self, batches: Batches, journal: Journal | None, listener: Listener) -> None:
        """Steps until the budget is spent, then the last checkpoint and the averaged weights."""
        started, before = self.budget.clock(), self.seconds
        saved = time.monotonic()
        source = batches(self.step)
        progress = self.budget.progress(self.step, self.seconds)
        self.module.train()
        while progress < 1.0:
            values = self._step(next(source), progress)
            self.seconds = before + self.budget.clock() - started
            # All processes must stop at the same step: the first one's clock counts.
            progress = self.fabric.broadcast(self.budget.progress(self.step, self.seconds))
            if self.step % self.config.record_every == 0 or progress >= 1.0:
                self.losses = {name: value.item() for name, value in values.items()}
                listener.advance(progress, self.losses)
                if journal is not None:
                    rate = learning_rate(min(progress, 1.0), self.config.optimiser)
                    journal.record(self.step, {**self.losses, "learning_rate": rate})
            if time.monotonic() - saved > self.config.checkpoint_seconds:
                self.save()
                saved = time.monotonic()
        self.module.eval()
        self.save()
        self.average.swap()

    def _step(self, batch: Batch, progress: float) -> dict[str, torch.Tensor]:
        set_learning_rate(self.optimisers, learning_rate(progress, self.config.optimiser))
        key = (self.stage.name, self.step, self.fabric.global_rank)
        seed = int(seed_sequence(self.config.seed, *key).generate_state(1)[0])
        losses = self.module(self.fabric.to_device(batch), seed=seed)
        self.fabric.backward(losses["loss"])
        trained = [p for p in self.stage.parameters() if p.grad is not None]
        torch.nn.utils.clip_grad_norm_(trained, self.config.clip)
        for optimiser in self.optimisers:
            optimiser.step()
            optimiser.zero_grad()
        self.average.update()
        self.step += 1
        return {name: value.detach() for name, value in losses.items()}

    def save(self) -> None:
        """Checkpoint and averaged weights, each file whole or not at all."""
        if self.out is None or not self.fabric.is_global_zero:
            return
        buffer = io.BytesIO()
        torch.save(
            {
                "identity": self._identity(),
                "step": self.step,
                "seconds": self.seconds,
                "model": self.stage.model.state_dict(),
                "optimisers": [_optimiser(o).state_dict() for o in self.optimisers],
                "average": self.average.state_dict(),
            },
            buffer,
        )
        self.out.mkdir(parents=True, exist_ok=True)
        write_atomically(self.out / STATE, buffer.getvalue())
        self.average.swap()
        progress = {"stage": self.stage.name, "step": self.step, "seconds": round(self.seconds, 3)}
        save_weights(self.stage.model, self.out, provenance={**self.provenance, "state": progress})
        self.average.swap()

    def restore(self) -> None:
        """Go on from the checkpoint in `out`, if there is one."""
        path = None if self.out is None else self.out / STATE
        if path is None or not path.exists():
            return
        state = torch.load(path, map_location="cpu", weights_only=True)
        if state["identity"] != self._identity():
            raise BadInputError(
                f"{path} is a checkpoint of another stage, model or configuration; "
                "resume with the options it was begun with, or give another --out"
            )
        self.step, self.seconds = state["step"], state["seconds"]
        self.stage.model.load_state_dict(state["model"])
        for optimiser, saved in zip(self.optimisers, state["optimisers"], strict=True):
            _optimiser(optimiser).load_state_dict(saved)
        self.average.load_state_dict(state["average"])

    def _identity(self) -> str:
        """What must not change between a checkpoint and its resumption."""
        parts = (
            self.stage.name,
            asdict(self.stage.model.config),
            asdict(self.config.optimiser),
            self.config.average_decay,
            self.config.clip,
            self.config.seed,
            # How often something is saved or recorded, which stands in `train`, changes no weight.
            {name: value for name, value in self.provenance.items() if name != "train"},
        )
        return repr(parts)


def _optimiser(wrapped: Any) -> Optimizer:
    """The optimiser itself inside Fabric's wrapper."""
    return getattr(wrapped, "optimizer", wrapped)
