"""What a recording's key frames must satisfy (`validate --deep`), beside what any depth must."""

from collections.abc import Iterator

import numpy as np

from doughdata.dataset.report import Problem
from doughdata.dataset.shards import LayerShard

__all__ = ["recorded_problems"]


def recorded_problems(shard: LayerShard) -> Iterator[Problem]:
    """Problems of one recording: its times, its frames and its colour images."""
    file = str(shard.commit.path)
    for index in shard.commit.scenes:
        frames = shard.table("frames").scene(index)
        times = frames["timestamp"].to_numpy()
        if not (np.isfinite(times).all() and np.all(np.diff(times) > 0)):
            yield Problem(file=file, message=f"scene {index}: timestamps must rise")
        count = shard.table("scenes").scene(index)["num_frames"][0].as_py()
        if frames["frame_index"].to_pylist() != list(range(count)):
            yield Problem(file=file, message=f"scene {index}: key frames must be 0..{count - 1}")
        views = shard.table("views").scene(index)
        if views["frame_index"].to_pylist() != list(range(count)):
            yield Problem(file=file, message=f"scene {index}: every key frame must have one view")
    if "color" in shard.array_names:
        depth, color = shard.array("depth").shape, shard.array("color").shape
        if color != (*depth, 3):
            yield Problem(file=file, message="colour images must have the size of the depth images")
