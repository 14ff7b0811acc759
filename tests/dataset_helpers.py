"""Writing the closed-form examples as datasets, and comparing records."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from doughdata.dataset import DatasetSettings, DatasetWriter, StageRecord, open_writer
from tests.closed_form import NUM_FRAMES, Example, cut_ring, joined_bars

LAYERS = ("sim", "topology", "mesh", "depth.none")
STAGES = {
    "sim": StageRecord(name="cubes", version="1", config={"spacing": 0.002}),
    "topology": StageRecord(name="counted", version="1"),
    "mesh": StageRecord(name="faces", version="1", config={"label_spacing": 0.001}),
    "depth.none": StageRecord(name="none", version="1", config={"views": 1}),
}


def record_of(example: Example, layer: str) -> Any:
    """The record of one layer."""
    return {
        "sim": example.particles,
        "topology": example.topology,
        "mesh": example.meshes,
        "depth.none": example.depth,
    }[layer]


def new_writer(path: Path, **settings: Any) -> DatasetWriter:
    """A new dataset with the examples' number of key frames."""
    options = {"num_frames": NUM_FRAMES, "stages": STAGES} | settings
    return open_writer(str(path), DatasetSettings(**options))


def write_examples(
    writer: DatasetWriter,
    examples: Sequence[Example] | None = None,
    *,
    layers: Sequence[str] = LAYERS,
    failed: Mapping[str, Mapping[int, str]] | None = None,
) -> DatasetWriter:
    """Plan the examples as user-written scenes and write the layers; then refresh."""
    examples = [cut_ring(), joined_bars()] if examples is None else examples
    writer.plan_scenes([example.scene for example in examples])
    for layer in layers:
        reasons = (failed or {}).get(layer, {})
        for task in writer.tasks(layer):
            done = {i: record_of(examples[i], layer) for i in task.scenes if i not in reasons}
            bad = {i: reasons[i] for i in task.scenes if i in reasons}
            writer.write(task, done, stage=STAGES[layer], failed=bad)
    writer.refresh()
    return writer


def equal(a: Any, b: Any) -> bool:
    """Whether two records hold the same values, dtypes and shapes, bit for bit."""
    if is_dataclass(a):
        return type(a) is type(b) and all(
            equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a)
        )
    if isinstance(a, np.ndarray):
        return (a.dtype, a.shape) == (b.dtype, b.shape) and a.tobytes() == b.tobytes()
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(equal, a, b))
    return a == b
