"""Several key frames of a scene in a row as a PyTorch map-style dataset: for dynamics."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.data import Dataset

from doughdata.dataset import open_dataset
from doughdata.torch.views import SampleSize, choose_views, frame_sample
from doughschemas import BadInputError

__all__ = ["DoughSequences"]


class DoughSequences(Dataset[dict[str, Tensor]]):
    """Windows over the key frames of a scene, seen from one camera: t, t + 1, ... by position.

    With `length=3` a sample is a triple (t, t + k, t + 2k) of the chosen key frames, `k` being the
    stride, for two-step dynamics; with `length=None` it is the whole scene. Every tensor of
    `DoughDataset` has a first axis of frames here, the indices as well. Workers, seeds and epochs
    are as there.

    Args:
        uri: the dataset.
        length: key frames a sample; None = all that are chosen of a scene.
        stride: chosen key frames from one to the next of a sample.
        sensor: which depth layer, e.g. "realsense"; "complete" takes points all over the true
            surfaces, of every key frame, instead.
        split: "train" or "test"; None takes both.
        frames: key frames to step through; None takes every one that has a view.
        num_points: points a key frame; drawn again if the view has fewer.
        num_queries: queries a key frame.
        num_tool_points: points a finger.
        max_components: length of `genus`.
        seed: root of all random choices.

    Raises:
        MissingLayerError: the dataset has no such depth layer; names the command that makes it.
        BadInputError: nothing is left after the choice, or no scene has `length` key frames.
    """

    def __init__(
        self,
        uri: str | Path,
        *,
        length: int | None = 3,
        stride: int = 1,
        sensor: str = "realsense",
        split: str | None = None,
        frames: Collection[int] | None = None,
        num_points: int = 1024,
        num_queries: int = 2048,
        num_tool_points: int = 128,
        max_components: int = 8,
        seed: int = 0,
    ) -> None:
        if stride < 1 or (length is not None and length < 1):
            raise BadInputError(f"length and stride must be at least 1, got {length=}, {stride=}")
        self.source = open_dataset(uri)
        self.sensor, self.seed = sensor, seed
        self.size = SampleSize(
            num_points=num_points,
            num_queries=num_queries,
            num_tool_points=num_tool_points,
            max_components=max_components,
        )
        views = choose_views(self.source, sensor, split=split, frames=frames)
        self._windows = _windows(views, length, stride)
        if not self._windows:
            raise BadInputError(
                f"{uri}: no scene has {length} of the chosen key frames from one camera; render "
                f"more with `doughdata render --noise {sensor} --all-frames`, or ask for fewer"
            )
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        """Number of windows."""
        return len(self._windows)

    @property
    def places(self) -> Int64[np.ndarray, "samples 2"]:
        """(scene_index, frame_index) of the last key frame of every window."""
        return np.array([(scene, frames[-1]) for scene, _, frames in self._windows], np.int64)

    def set_epoch(self, epoch: int) -> None:
        """Draw other points and queries from now on; the same epoch gives the same again."""
        self._epoch.fill_(epoch)

    def __getitem__(self, index: int | tuple[int, int]) -> dict[str, Tensor]:
        """One window, by its index or by (epoch, index).

        Raises:
            IndexError: no such window.
            DamagedDatasetError: a byte on disk has changed.
        """
        epoch, index = index if isinstance(index, tuple) else (int(self._epoch), index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"sequence {index} of {len(self)}")
        scene, view, frames = self._windows[index]
        samples = [
            frame_sample(
                self.source.frame(scene=scene, frame=frame),
                self.sensor,
                view,
                self.size,
                seed=self.seed,
                epoch=epoch,
            )
            for frame in frames
        ]
        return {name: torch.stack([sample[name] for sample in samples]) for name in samples[0]}


def _windows(
    views: Int64[np.ndarray, "views 3"], length: int | None, stride: int
) -> list[tuple[int, int, tuple[int, ...]]]:
    """(scene, view, key frames) of every window over one scene and camera."""
    frames_of: dict[tuple[int, int], list[int]] = {}
    for scene, frame, view in views.tolist():
        frames_of.setdefault((scene, view), []).append(frame)
    windows = []
    for (scene, view), frames in sorted(frames_of.items()):
        ordered = sorted(frames)
        span = ((length or -(-len(ordered) // stride)) - 1) * stride + 1
        starts = range(len(ordered) - span + 1) if length else range(1)
        windows += [(scene, view, tuple(ordered[k : k + span : stride])) for k in starts]
    return windows
