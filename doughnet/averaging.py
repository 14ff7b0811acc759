"""Exponential moving average of weights: what is evaluated and kept."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

__all__ = ["WeightAverage"]


class WeightAverage:
    """Moving average of a module's trained parameters.

    The decay rises with the number of updates, min(decay, (1 + n) / (10 + n)), so that the first
    random weights are soon forgotten.
    """

    def __init__(self, module: nn.Module, *, decay: float) -> None:
        self.decay, self.updates = decay, 0
        self._source = {n: p for n, p in module.named_parameters() if p.requires_grad}
        self._average = {n: p.detach().clone() for n, p in self._source.items()}

    @torch.no_grad()
    def update(self) -> None:
        """Take the present weights in."""
        self.updates += 1
        share = 1 - min(self.decay, (1 + self.updates) / (10 + self.updates))
        for name, parameter in self._source.items():
            self._average[name].lerp_(parameter, share)

    @torch.no_grad()
    def swap(self) -> None:
        """Exchange the average and the module's own weights; twice is as before."""
        for name, parameter in self._source.items():
            kept = parameter.clone()
            parameter.copy_(self._average[name])
            self._average[name].copy_(kept)

    def state_dict(self) -> dict[str, Tensor | int]:
        """Average and number of updates."""
        return {**self._average, "updates": self.updates}

    @torch.no_grad()
    def load_state_dict(self, state: Mapping[str, Tensor | int]) -> None:
        """Go on from what `state_dict` gave."""
        self.updates = int(state["updates"])
        for name, value in self._average.items():
            value.copy_(torch.as_tensor(state[name]))
