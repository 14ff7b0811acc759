"""One scene as the model sees it coming: from the first view and the tool's motion alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from doughdata.dataset import Dataset, Frame
from doughdata.seeds import seed_sequence
from doughdata.torch.sampling import dough_points, tool_points
from doughnet.data import KEY_FRAMES
from doughnet.lattice import Lattice, on_lattice, workspace_lattice
from doughnet.model import DoughNet, Shape
from doughschemas import NO_COMPONENT, BadInputError, MissingLayerError

__all__ = ["PredictedFrame", "Prediction", "predict"]

MOST_FRAMES = 13  # of a recording
NUM_POINTS, NUM_TOOL_POINTS = 1024, 128


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedFrame:
    """What was seen, predicted and true of one key frame."""

    frame_index: int
    timestamp: float  # [s]
    points: Float64[np.ndarray, "points 3"]  # [m], world; what the camera saw
    point_labels: Int64[np.ndarray, " points"]
    shape: Shape
    true_labels: Int64[Tensor, "nx ny nz"] | None  # on the same lattice; None in a recording
    true_genus: tuple[int, ...] | None
    tools: Any  # `FrameTools`; None in a recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A whole scene; `rolled_out` tells whether only the first frame was seen."""

    scene_index: int
    lattice: Lattice
    frames: tuple[PredictedFrame, ...]
    rolled_out: bool


@torch.inference_mode()
def predict(
    model: DoughNet,
    source: Dataset,
    *,
    scene: int,
    sensor: str,
    frames: Sequence[int] | None = None,
    seed: int = 0,
) -> Prediction:
    """Predict a scene from its first view.

    In a recording the tool's shape is not known, so that each frame is reconstructed from its own
    view instead, and nothing is known to be true.

    Args:
        model: in evaluation mode, on the CPU.
        source: the dataset.
        scene: scene_index.
        sensor: depth layer that is looked at.
        frames: key frames to step through; by default the model's own of those that were rendered.
        seed: of the choice of points.

    Raises:
        BadInputError: the scene has no such views, or its first one shows no dough.
    """
    views = source.read_depth(scene, sensor)
    chosen = _chosen(views.frame_index.tolist(), frames)
    lattice = workspace_lattice()
    rng = np.random.default_rng(seed_sequence(seed, "predict", scene))
    there = [source.frame(scene=scene, frame=frame) for frame in chosen]
    first_view = int(views.view_index[0])
    seen = [dough_points(f.depth(sensor), first_view, NUM_POINTS, rng) for f in there]
    if (seen[0][1] < 0).all():
        raise BadInputError(f"scene {scene}: no dough is seen in key frame {chosen[0]}")
    tools = [_tools(frame) for frame in there]
    points = torch.from_numpy(np.stack([p for p, _ in seen])).float()
    latents = model.encode(points, torch.from_numpy(np.stack([labels for _, labels in seen])))
    rolled_out = all(tool is not None for tool in tools) and len(there) > 1
    if rolled_out:
        moved = np.stack([tool_points(tool, NUM_TOOL_POINTS, rng) for tool in tools])
        steps = model.rollout(latents[:1], torch.from_numpy(moved).float()[None])[0]
        latents = torch.cat([latents[:1], steps])
    found = [
        _frame(frame, view, model.decode(z_TD, lattice), tool, lattice)
        for frame, view, z_TD, tool in zip(there, seen, latents, tools, strict=True)
    ]
    return Prediction(
        scene_index=scene, lattice=lattice, frames=tuple(found), rolled_out=rolled_out
    )


def _chosen(rendered: Sequence[int], wanted: Sequence[int] | None) -> list[int]:
    """Key frames to step through, all of them rendered."""
    there = sorted(set(rendered))
    if wanted is not None:
        missing = sorted(set(wanted) - set(there))
        if missing:
            raise BadInputError(f"no views of key frames {missing} (there are {there})")
        return sorted(wanted)
    if set(KEY_FRAMES) <= set(there):
        return list(KEY_FRAMES)
    step = max(1, -(-len(there) // MOST_FRAMES))
    return there[::step]


def _tools(frame: Frame) -> Any:
    try:
        return frame.tools
    except MissingLayerError:
        return None


def _frame(frame: Frame, seen: Any, shape: Shape, tools: Any, lattice: Lattice) -> PredictedFrame:
    labels, genus = None, None
    try:
        grid = on_lattice(frame.label_grid, lattice).astype(np.int64)
        genus = tuple(frame.topology.genus)
        labels = torch.from_numpy(np.where(grid == NO_COMPONENT, len(genus), grid))
    except MissingLayerError:
        pass  # a recording: nothing is known to be true
    return PredictedFrame(
        frame_index=frame.frame_index,
        timestamp=frame.timestamp,
        points=seen[0],
        point_labels=seen[1],
        shape=shape,
        true_labels=labels,
        true_genus=genus,
        tools=tools,
    )
