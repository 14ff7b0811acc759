"""Turn a robot's recording into observations for a model.

Run: python examples/06_convert_a_recording.py RECORDING.mcap DATASET [rolls|doughnut]
"""

import sys
from pathlib import Path

from doughdata import open_dataset
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.options import ProcessingConfig
from doughdata.torch import DoughDataset


def main(recording: str, dataset: str, expect: str | None = None) -> None:
    """Convert, look at what was found, and take a sample as training does."""
    config = ProcessingConfig(expect=expect)  # table, height band, outliers, voxels, pieces
    done = Mcap().convert(Path(recording), dataset, processing=config)
    for loss in done.losses:
        print("lost:", loss)

    opened = open_dataset(dataset)
    scene = done.scenes[0]
    views = opened.read_depth(scene, "recorded")
    camera = views.cameras[0]
    print(f"{done.frames} key frames, depth in steps of {views.depth_unit * 1e3:g} mm")
    print(f"the camera is {camera.position[2] * 1e3:.0f} mm above the table")

    sample = DoughDataset(dataset, split="real")[0]  # the tensors that simulated scenes give
    heights = sample["points"][:, 2] * 1e3
    print(f"{int(sample['num_components'])} pieces of dough, up to {heights.max():.0f} mm high")
    assert config.height_min * 1e3 <= heights.min() + 1  # what is lower counts as table


if __name__ == "__main__":
    main(*sys.argv[1:4])
