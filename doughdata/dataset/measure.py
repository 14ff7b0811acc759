"""Statistics of a whole dataset: from its tables at once, from its arrays when someone asks."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from doughdata.dataset.describe import known_arrays
from doughdata.dataset.reader import open_dataset
from doughdata.dataset.statistics import (
    Moments,
    dataset_sizes,
    table_features,
    topology_statistics,
)
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.tables import TABLES
from doughschemas import MissingLayerError

__all__ = ["dataset_statistics", "measure_arrays"]


def dataset_statistics(uri: str | Path | Store) -> dict[str, Any]:
    """`sizes`, `families` (how scenes end) and `features` (ranges; of arrays as last measured).

    Raises:
        DatasetError: no dataset there.
    """
    store = store_of(uri)
    dataset = open_dataset(store)
    tables = {name: dataset.table(name) for name in TABLES}
    return {
        "sizes": dataset_sizes(dataset.info, tables),
        "families": topology_statistics(tables),
        "features": {**table_features(tables), **known_arrays(store, dataset.fingerprint)},
    }


def measure_arrays(uri: str | Path | Store) -> dict[str, dict[str, list]]:
    """`sim/positions` [m] and `depth.<sensor>/depth` [m, valid pixels], read scene by scene.

    Raises:
        DatasetError: no dataset there.
        DamagedDatasetError: a chunk does not fit its checksum.
    """
    dataset = open_dataset(uri)
    found: dict[str, Moments] = defaultdict(Moments)
    for scene in dataset.scene_indices:
        for layer in dataset.layers:
            try:
                dataset.layer(layer, scene)
            except MissingLayerError:
                continue  # not made, stale, or this scene failed in it
            if layer == "sim":
                for points in dataset.read_particles(scene).positions:
                    found["sim/positions"].add(points)
            elif layer.startswith("depth."):
                views = dataset.read_depth(scene, layer.partition(".")[2])
                for image in views.depth:
                    found[f"{layer}/depth"].add(image[image > 0][:, None] * views.depth_unit)
    return {name: moments.to_json() for name, moments in found.items() if moments.count}
