"""Muon for matrices, AdamW for the rest, and one schedule for both."""

from dataclasses import dataclass

from torch import nn
from torch.optim import AdamW, Optimizer

from doughnet.muon import BatchedMuon

__all__ = ["OptimiserConfig", "learning_rate", "optimisers", "set_learning_rate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OptimiserConfig:
    """How fast the weights move."""

    muon: bool = True  # False: AdamW for everything
    learning_rate: float = 2e-3  # of both; Muon's steps are scaled to AdamW's size
    weight_decay: float = 0.01
    warm_up: float = 0.03  # share of the training in which the rate rises from 0
    cool_down: float = 0.5  # share at the end in which it falls to 0


def optimisers(module: nn.Module, config: OptimiserConfig) -> list[Optimizer]:
    """Optimisers of all parameters that are trained.

    Muon (Jordan et al. 2024) is for the matrices that map tokens to tokens. Embeddings, learned
    queries, heads, norms and offsets have no such meaning and go to AdamW.
    """
    trained = [(name, p) for name, p in module.named_parameters() if p.requires_grad]
    matrices = [p for name, p in trained if config.muon and _maps_tokens(name, p)]
    chosen = {id(p) for p in matrices}
    rest = [p for _, p in trained if id(p) not in chosen]
    found: list[Optimizer] = []
    if rest:
        decayed = {"params": [p for p in rest if p.ndim > 1]}
        plain = {"params": [p for p in rest if p.ndim <= 1], "weight_decay": 0.0}
        groups = [group for group in (decayed, plain) if group["params"]]
        rate, decay = config.learning_rate, config.weight_decay
        found.append(AdamW(groups, lr=rate, weight_decay=decay, betas=(0.9, 0.98)))
    if matrices:
        found.append(
            BatchedMuon(matrices, lr=config.learning_rate, weight_decay=config.weight_decay)
        )
    return found


def learning_rate(progress: float, config: OptimiserConfig) -> float:
    """Learning rate after a share `progress` of the training: up, level, down to zero."""
    up = progress / config.warm_up if config.warm_up else 1.0
    down = (1.0 - progress) / config.cool_down if config.cool_down else 1.0
    return config.learning_rate * max(0.0, min(up, 1.0, down))


def set_learning_rate(found: list[Optimizer], rate: float) -> None:
    """Give all parameters this learning rate."""
    for optimiser in found:
        for group in optimiser.param_groups:
            group["lr"] = rate


def _maps_tokens(name: str, parameter: nn.Parameter) -> bool:
    return parameter.ndim == 2 and any(part in name for part in (".attention.", ".feed_forward."))
