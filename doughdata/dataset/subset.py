"""Some scenes of a dataset become a dataset of their own."""

from pathlib import Path

from doughdata.dataset.commits import StageRecord
from doughdata.dataset.reader import open_dataset
from doughdata.dataset.replan import Part
from doughdata.dataset.selection import SceneFilter
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.transfer import Copied, OnScenes, transfer
from doughschemas import BadInputError

__all__ = ["subset"]


def subset(
    source: str | Path | Store,
    into: str | Path | Store,
    wanted: SceneFilter,
    *,
    on_scenes: OnScenes | None = None,
) -> Copied:
    """Make a new dataset of the scenes that satisfy a filter. The same call again resumes.

    Args:
        source: the dataset; nothing in it changes.
        into: where the new dataset is made.
        wanted: which scenes; scenes that failed in the simulation are never taken.
        on_scenes: hears how far it is.

    Raises:
        BadInputError: no condition, a condition about something that is not there, or no scene
            satisfies all of them.
        DatasetError: there is something else at the target.
        DamagedDatasetError: a file of the source is missing or has changed.
    """
    if wanted == SceneFilter():
        raise BadInputError("say which scenes: a subset needs at least one condition")
    store = store_of(source)
    dataset = open_dataset(store)
    part = Part.of(dataset, store, scenes=wanted.choose(dataset))
    stages = {layer: StageRecord(**made) for layer, made in dataset.info["stages"].items()}
    return transfer("subset", [part], into, stages=stages, on_scenes=on_scenes)
