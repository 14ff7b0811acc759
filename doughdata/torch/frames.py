"""Single views as a PyTorch map-style dataset: for shape and topology."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor
from torch.utils.data import Dataset

from doughdata.dataset import open_dataset
from doughdata.torch.views import SampleSize, choose_views, frame_sample

__all__ = ["DoughDataset"]


class DoughDataset(Dataset[dict[str, Tensor]]):
    """Samples for shape and topology learning, one per depth view.

    A sample holds, as float32 in [m], world frame:

    - `points` (num_points, 3): back-projected dough pixels;
    - `queries` (num_queries, 3): half uniform in the workspace, half about the surface;
    - `tool_points` (2, num_tool_points, 3): on the surfaces of both fingers;

    and as int64:

    - `point_labels` (num_points,): component of each point;
    - `query_labels` (num_queries,): component at the nearest node of the label grid, or
      `num_components` for empty space;
    - `genus` (max_components,), padded with -1;
    - `num_components`, `scene_index`, `frame_index`, `view_index`: scalars.

    A view in which no dough is seen has zeros as points and -1 as their labels.

    Recordings give the same tensors. What nobody can measure is -1: `query_labels` and `genus`.
    `point_labels` and `num_components` are the pieces as seen in this very frame, the queries are
    all uniform, and `tool_points` are zeros.

    Picklable, safe with `fork`, `spawn` and `forkserver` workers. A sample depends on seed, epoch,
    scene, frame and view alone, never on the number of workers. The epoch is that of `set_epoch`,
    or comes with the index as a pair (epoch, index), as `EndlessSampler` draws them.

    Args:
        uri: the dataset.
        sensor: which depth layer; None = "recorded" for the split "real", else "realsense".
            "complete" takes points all over the true surfaces, of every key frame, instead.
        split: "train", "test" or "real"; None takes all.
        frames: key frames to use; None takes every one that has a view.
        num_points: points a sample; drawn again if the view has fewer.
        num_queries: queries a sample.
        num_tool_points: points a finger.
        max_components: length of `genus`.
        seed: root of all random choices.

    Raises:
        MissingLayerError: the dataset has no such depth layer; names the command that makes it.
        BadInputError: nothing is left after the choice of split and frames.
    """

    def __init__(
        self,
        uri: str | Path,
        *,
        sensor: str | None = None,
        split: str | None = None,
        frames: Collection[int] | None = None,
        num_points: int = 1024,
        num_queries: int = 2048,
        num_tool_points: int = 128,
        max_components: int = 8,
        seed: int = 0,
    ) -> None:
        self.source = open_dataset(uri)
        self.sensor = sensor or ("recorded" if split == "real" else "realsense")
        self.seed = seed
        self.size = SampleSize(
            num_points=num_points,
            num_queries=num_queries,
            num_tool_points=num_tool_points,
            max_components=max_components,
        )
        self._views = choose_views(self.source, self.sensor, split=split, frames=frames)
        # In shared memory, so that `set_epoch` reaches workers that are already running.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        """Number of views."""
        return len(self._views)

    @property
    def rendered_frames(self) -> tuple[int, ...]:
        """Key frames that are served, of any scene, rising."""
        return tuple(sorted(set(self._views[:, 1].tolist())))

    @property
    def places(self) -> Int64[np.ndarray, "samples 2"]:
        """(scene_index, frame_index) of every sample."""
        return self._views[:, :2]

    def set_epoch(self, epoch: int) -> None:
        """Draw other points and queries from now on; the same epoch gives the same again."""
        self._epoch.fill_(epoch)

    def __getitem__(self, index: int | tuple[int, int]) -> dict[str, Tensor]:
        """One sample, by its index or by (epoch, index).

        Raises:
            IndexError: no such view.
            DamagedDatasetError: a byte on disk has changed.
        """
        epoch, index = index if isinstance(index, tuple) else (int(self._epoch), index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"view {index} of {len(self)}")
        scene, frame_index, view = (int(value) for value in self._views[index])
        frame = self.source.frame(scene=scene, frame=frame_index)
        return frame_sample(frame, self.sensor, view, self.size, seed=self.seed, epoch=epoch)
