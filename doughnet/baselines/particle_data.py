"""Windows of tracked particles for the graph network: history, tool, and what follows."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor
from torch.utils.data import Dataset

from doughdata.dataset import Frame, open_dataset
from doughdata.seeds import seed_sequence
from doughdata.torch.sampling import tool_points
from doughnet.baselines.particle_net import ParticleConfig
from doughschemas import BadInputError

__all__ = ["ParticleWindows", "finger_points", "spacing_of", "spread"]


class ParticleWindows(Dataset[dict[str, Tensor]]):
    """Particles of the last key frames, of the next ones, and the tool between them.

    At a scene's start the first key frame stands for those before it, as it does in prediction.

    Args:
        uri: the dataset.
        config: sizes.
        frames: key frames to step through.
        split: "train" or "test"; None takes both.
        steps: key frames to predict.
        seed: root of all random choices.

    Raises:
        BadInputError: no scene of the split, or too few key frames.
    """

    sensor = "particles"  # what it looks at, for the record of a training

    def __init__(
        self,
        uri: str,
        *,
        config: ParticleConfig,
        frames: Sequence[int],
        split: str | None = None,
        steps: int = 2,
        seed: int = 0,
    ) -> None:
        self.source, self.config, self.steps, self.seed = open_dataset(uri), config, steps, seed
        splits = self.source.scenes.select(["scene_index", "split"]).to_pylist()
        scenes = [row["scene_index"] for row in splits if split in (None, row["split"])]
        self._frames = tuple(frames)
        # scene, and position of the present key frame among those that are stepped through
        self._windows = [(scene, now) for scene in scenes for now in range(len(frames) - steps)]
        if not self._windows:
            raise BadInputError(
                f"{uri}: no scene of split {split!r} with {steps + 1} key frames or more"
            )

    def __len__(self) -> int:
        """Number of windows."""
        return len(self._windows)

    def __getitem__(self, index: int | tuple[int, int]) -> dict[str, Tensor]:
        """One window, by its index or by (epoch, index).

        `history` (H, N, 3), `target` (steps, N, 3) and `tool` (steps + 1, T, 3) in metres, world;
        `spacing` [m].

        Raises:
            IndexError: no such window.
        """
        epoch, index = index if isinstance(index, tuple) else (0, index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"window {index} of {len(self)}")
        (scene, now), config = self._windows[index], self.config
        rng = np.random.default_rng(seed_sequence(self.seed, "particles", epoch, index))
        past = [now - back for back in reversed(range(config.history))]
        coming = list(range(now, now + self.steps + 1))
        known = {
            k: self.source.frame(scene=scene, frame=self._frames[k])
            for k in {*(max(k, 0) for k in past), *coming}
        }
        all_of_it = known[now].particles
        count = len(all_of_it.positions)
        start = int(rng.integers(count))
        chosen = spread(torch.tensor(all_of_it.positions), config.particles, start=start).numpy()
        volume = count * all_of_it.spacing**3
        tools = [known[k] for k in coming]

        def at(k: int) -> Tensor:
            return torch.tensor(known[max(k, 0)].particles.positions[chosen])

        return {
            "history": torch.stack([at(k) for k in past]),
            "target": torch.stack([at(k) for k in coming[1:]]),
            "tool": finger_points(tools, config.tool_points, seed=int(rng.integers(2**32))),
            "spacing": torch.tensor(spacing_of(volume, config.particles)),
        }


def spacing_of(volume: float, particles: int) -> float:
    """Side [m] of the cube that each of some particles stands for."""
    return float((volume / particles) ** (1 / 3))


def spread(
    points: Float32[Tensor, "all 3"], count: int, *, start: int = 0
) -> Int64[Tensor, " count"]:
    """Index of some points, evenly spread: each next one is the farthest from those before it.

    Fewer points than that are repeated.
    """
    chosen = [start]
    away = (points - points[start]).norm(dim=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(away.argmax()))
        away = torch.minimum(away, (points - points[chosen[-1]]).norm(dim=1))
    return torch.tensor(chosen)[torch.arange(count) % len(chosen)]


def finger_points(frames: Sequence[Frame], count: int, *, seed: int) -> Tensor:
    """The same points of all fingers in several key frames, (frames, fingers * count, 3) [m]."""
    points = [tool_points(own.tools, count, np.random.default_rng(seed)) for own in frames]
    return torch.from_numpy(np.stack(points).reshape(len(frames), -1, 3).astype(np.float32))
