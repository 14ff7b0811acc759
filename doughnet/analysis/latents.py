"""Latents of whole scenes, and what is true of every key frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from doughdata.dataset import Dataset
from doughdata.seeds import seed_sequence
from doughdata.torch.sampling import dough_points
from doughnet.model import DoughNet

__all__ = ["SceneLatents", "scene_latents"]

NUM_POINTS = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneLatents:
    """One scene, as the encoder sees it from its first camera."""

    scene_index: int
    family: str
    frames: Int64[np.ndarray, " frames"]  # key frames that have a view
    mean: Float32[np.ndarray, "frames width"]  # over the set of latents
    genus: tuple[tuple[int, ...], ...]  # sorted, of every key frame
    changed: Bool[np.ndarray, " steps"]  # whether the topology changed since the frame before


@torch.inference_mode()
def scene_latents(
    model: DoughNet,
    source: Dataset,
    *,
    scenes: Sequence[int],
    sensor: str,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> list[SceneLatents]:
    """Latents of every key frame of some scenes that was rendered; scenes with one are left out."""
    found = []
    for number, scene in enumerate(scenes, 1):
        views = source.read_depth(scene, sensor)
        own = views.view_index == views.view_index[0]
        frames = views.frame_index[own].astype(np.int64)
        rng = np.random.default_rng(seed_sequence(seed, "latents", scene))
        means, genus = [], []
        for frame in frames.tolist():
            there = source.frame(scene=scene, frame=frame)
            seen = dough_points(there.depth(sensor), int(views.view_index[0]), NUM_POINTS, rng)
            points, labels = (torch.from_numpy(values)[None] for values in seen)
            means.append(model.encode(points.float(), labels)[0].mean(dim=0).numpy())
            genus.append(tuple(sorted(there.genus)))
        if len(frames) > 1:
            found.append(
                SceneLatents(
                    scene_index=scene,
                    family=source.scene(scene).family,
                    frames=frames,
                    mean=np.stack(means),
                    genus=tuple(genus),
                    changed=_changed(source, scene, frames),
                )
            )
        if progress is not None:
            progress(number, len(scenes))
    return found


def _changed(
    source: Dataset, scene: int, frames: Int64[np.ndarray, " frames"]
) -> Bool[np.ndarray, " steps"]:
    """Whether an event lies in (frames[k], frames[k + 1]]."""
    events = np.array([event.frame for event in source.read_topology(scene).events], np.int64)
    return np.array(
        [((events > a) & (events <= b)).any() for a, b in pairwise(frames)],
        bool,
    )
