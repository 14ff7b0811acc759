"""Muon in single precision, all matrices of one shape at a time.

`torch.optim.Muon` orthogonalises each matrix by itself in bfloat16. Without bfloat16 arithmetic a
CPU does that thirty times slower than in float32 (`LOG.md`); and small matrices are faster in one
batch on any device.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim import Muon

__all__ = ["BatchedMuon", "orthogonalised"]


class BatchedMuon(Muon):
    """`torch.optim.Muon` with Nesterov's momentum and AdamW's length of step, in float32."""

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Move all matrices that have a gradient."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            alike: dict[torch.Size, list[Tensor]] = defaultdict(list)
            for parameter in group["params"]:
                if parameter.grad is not None:
                    alike[parameter.shape].append(parameter)
            for parameters in alike.values():
                self._move(parameters, group)
        return loss

    def _move(self, parameters: list[Tensor], group: dict[str, Any]) -> None:
        """One step of matrices of one shape (Jordan et al. 2024; rates as Liu et al. 2025)."""
        directions = []
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        for parameter, gradient in zip(parameters, gradients, strict=True):
            state = self.state[parameter]
            if "momentum_buffer" not in state:
                state["momentum_buffer"] = torch.zeros_like(gradient)
            momentum = state["momentum_buffer"].lerp_(gradient, 1 - group["momentum"])
            directions.append(gradient.lerp(momentum, group["momentum"]))
        steps = orthogonalised(
            torch.stack(directions), coefficients=group["ns_coefficients"], steps=group["ns_steps"]
        )
        # As long as a step of AdamW, whose entries are about 0.2 of the rate.
        rate = group["lr"] * 0.2 * max(parameters[0].shape) ** 0.5
        for parameter, step in zip(parameters, steps, strict=True):
            parameter.mul_(1 - group["lr"] * group["weight_decay"]).sub_(step, alpha=rate)


def orthogonalised(
    matrices: Float[Tensor, "count rows columns"],
    *,
    coefficients: tuple[float, float, float] = (3.4445, -4.7750, 2.0315),
    steps: int = 5,
) -> Float[Tensor, "count rows columns"]:
    """Matrices with the same singular vectors and singular values near 1 (Newton-Schulz)."""
    a, b, c = coefficients
    tall = matrices.shape[1] > matrices.shape[2]
    x = matrices.transpose(1, 2) if tall else matrices
    x = x / x.norm(dim=(1, 2), keepdim=True).clamp(min=1e-7)
    for _ in range(steps):
        gram = x @ x.transpose(1, 2)
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.transpose(1, 2) if tall else x
