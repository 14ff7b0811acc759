"""Make a small dataset, render it, and draw a contact sheet.

Run: python examples/01_make_and_look.py [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import doughdata
from doughdata import pipeline
from doughdata.dataset import DatasetSettings
from doughdata.executors.serial import SerialExecutor
from doughdata.mesh.dual_contouring import DualContouring
from doughdata.render.depth import DepthStage
from doughdata.render.sensors.realsense import RealSense
from doughdata.requests import FamilyScenes, Stages
from doughdata.sim.mpm import MpmSimulator, draft
from doughdata.sim.pull import MpmPullApart
from doughdata.topology.dynamic import DynamicCheck
from doughdata.view.sheet import save_sheet

FRAMES = 16


def main(folder: Path) -> None:
    """One scene of rolls with 16 key frames, stage by stage."""
    uri = str(folder / "dough")
    stages = Stages(
        simulator=MpmSimulator(replace(draft(), frames=FRAMES)),
        check=DynamicCheck(pull_apart=MpmPullApart()),
        mesher=DualContouring(),
    )
    wanted = [FamilyScenes(family="rolls", count=1, seed=0)]
    settings = DatasetSettings(num_frames=FRAMES)
    print(pipeline.generate(uri, wanted, stages, SerialExecutor(), settings=settings).as_text())
    print(
        pipeline.render(uri, DepthStage(), {"realsense": RealSense()}, SerialExecutor()).as_text()
    )

    ds = doughdata.open_dataset(uri)
    last = ds.frame(scene=0, frame=FRAMES - 1)
    print(f"scene 0 ends with c = {last.topology.num_components}, g = {last.topology.genus}")
    print(save_sheet(ds, folder / "sheet.png"))
    assert last.topology.num_components == len(last.meshes)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
