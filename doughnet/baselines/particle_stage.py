"""How the graph network is trained: two steps, compared as clouds.

Chamfer and earth mover's distance count 0.2 to 0.8 (Shi et al. 2023): who is who among the
particles is not told.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from doughnet.baselines.particle_net import ParticleNet
from doughnet.extras import train_package
from doughnet.stages import Batch, Losses

__all__ = ["ParticleStage", "chamfer", "earth_mover"]

CHAMFER, EARTH_MOVER = 0.2, 0.8
NOISE = 0.05  # [spacings], standard deviation of each past position


class ParticleStage(nn.Module):
    """Predict the next key frames, each from the network's own prediction of the one before."""

    name = "gnn"

    def __init__(self, model: ParticleNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, batch: Batch, *, seed: int) -> Losses:
        """Losses of a batch of windows; lengths count in spacings."""
        batch = _turned(batch, seed)
        history, spacing = batch["history"], batch["spacing"]
        losses: list[tuple[Tensor, Tensor]] = []
        for step in range(batch["target"].shape[1]):
            after = self.model(history, batch["tool"][:, step : step + 2], spacing)
            unit = spacing[:, None, None]
            own, other = after / unit, batch["target"][:, step] / unit
            losses.append((chamfer(own, other), earth_mover(own, other)))
            history = torch.cat([history[:, 1:], after[:, None]], dim=1)
        near, moved = (torch.stack(part).mean() for part in zip(*losses, strict=True))
        return {"loss": CHAMFER * near + EARTH_MOVER * moved, "chamfer": near, "emd": moved}


def chamfer(a: Float[Tensor, "B N 3"], b: Float[Tensor, "B M 3"]) -> Tensor:
    """Mean distance to the nearest point of the other cloud, both ways, over a batch."""
    away = torch.cdist(a, b)
    return (away.amin(dim=2).mean() + away.amin(dim=1).mean()) / 2


def earth_mover(a: Float[Tensor, "B N 3"], b: Float[Tensor, "B N 3"]) -> Tensor:
    """Mean distance to the partner when every point has its own and the sum is least."""
    solve = train_package("scipy.optimize").linear_sum_assignment
    with torch.no_grad():
        costs = torch.cdist(a, b).cpu().numpy()
        partner = torch.from_numpy(np.stack([solve(cost)[1] for cost in costs])).to(a.device)
    matched = b.gather(1, partner[..., None].expand(-1, -1, 3))
    return (a - matched).norm(dim=2).mean()


def _turned(batch: Batch, seed: int) -> Batch:
    """The batch turned about z by any angle, past positions a little off."""
    rng = torch.Generator().manual_seed(seed)
    angle = 2 * math.pi * torch.rand(len(batch["history"]), generator=rng)
    c, s, o = angle.cos(), angle.sin(), torch.zeros(len(angle))
    matrix = torch.stack([c, s, o, -s, c, o, o, o, o + 1], dim=1).reshape(-1, 1, 3, 3)
    matrix = matrix.to(batch["history"].device)
    noise = torch.randn(batch["history"].shape, generator=rng).to(matrix.device)
    turned = {name: batch[name] @ matrix for name in ("history", "target", "tool")}
    turned["history"] = turned["history"] + NOISE * noise * batch["spacing"][:, None, None, None]
    return {**batch, **turned}
