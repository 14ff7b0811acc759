"""Make a small dataset, render it, and draw a contact sheet.

Run: python examples/01_make_and_look.py [FOLDER]
"""

import sys
from pathlib import Path

import doughdata
from doughdata import pipeline
from doughdata.view.sheet import save_sheet


def main(folder: Path) -> None:
    """Two scenes of rolls with 15 key frames each."""
    dataset = str(folder / "dough")
    run = pipeline.Run(executor="serial")
    made = pipeline.generate(
        pipeline.GenerateRequest(dataset=dataset, scenes="rolls", num_scenes=1, frames=15), run
    )
    print(made.as_text())
    print(pipeline.render(pipeline.RenderRequest(dataset=dataset, sensors=("realsense",)), run).as_text())

    ds = doughdata.open_dataset(dataset)
    last = ds.frame(scene=0, frame=14)
    print(f"scene 0 ends with c = {last.topology.num_components}, g = {last.topology.genus}")
    print(save_sheet(ds, folder / "sheet.png"))
    assert last.topology.num_components == len(last.meshes)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
