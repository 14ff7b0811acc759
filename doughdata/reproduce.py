"""Make a scene again and compare with what the dataset holds, layer by layer.

Every layer is made again from the stored layers before it, so that one that differs does not make
the later ones differ too.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha256
from typing import Any

import numpy as np

from doughdata.dataset import Dataset
from doughdata.render.depth import DepthStage
from doughdata.scene_work import check_scene, mesh_scene, render_scene, simulate_scene
from doughdata.stages import Sensor
from doughschemas import Scene

__all__ = ["Comparison", "digest", "reproduce"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One layer of a scene, as stored and as made again."""

    layer: str
    stored: str  # sha256 over all values
    again: str
    difference: str = ""  # the first value that differs, by name

    @property
    def equal(self) -> bool:
        """Whether every value has the same bytes."""
        return self.stored == self.again


def reproduce(
    dataset: Dataset, scene_index: int, stages: Mapping[str, Any]
) -> Iterator[Comparison]:
    """Run a scene again through `stages` (layer -> stage) and compare each layer's values.

    For a layer `depth.<sensor>` the stage is a pair of `DepthStage` and sensor.

    Raises:
        MissingLayerError: the dataset lacks a layer, or the scene failed in it.
        SimulationError: the scene cannot be simulated any more.
    """
    scene = dataset.scene(scene_index)
    for layer, stage in stages.items():
        stored = _stored(dataset, scene_index, layer)
        again = _again(dataset, scene_index, scene, layer, stage)
        difference = next(_differences(stored, again, layer), "")
        yield Comparison(
            layer=layer, stored=digest(stored), again=digest(again), difference=difference
        )


def digest(record: Any) -> str:
    """sha256 over the names, types, shapes and bytes of all values of a record."""
    hashed = sha256()
    for name, value in _leaves(record, ""):
        hashed.update(f"{name}\0{_text(value)}\0".encode())
        if isinstance(value, np.ndarray):
            hashed.update(np.ascontiguousarray(value).tobytes())
    return hashed.hexdigest()


def _stored(dataset: Dataset, index: int, layer: str) -> Any:
    if layer == "sim":
        return dataset.read_particles(index)
    if layer == "topology":
        return dataset.read_topology(index)
    if layer == "mesh":
        return [dataset.read_meshes(index, frame) for frame in range(dataset.num_frames)]
    return dataset.read_depth(index, layer.partition(".")[2])


def _again(dataset: Dataset, index: int, scene: Scene, layer: str, stage: Any) -> Any:
    if layer == "sim":
        return simulate_scene(stage, scene)
    if layer == "topology":
        return check_scene(stage, scene, dataset, index)
    if layer == "mesh":
        return mesh_scene(stage, dataset, index)
    renderer, sensor = _depth_pair(stage)
    name = layer.partition(".")[2]
    return render_scene(renderer, {name: sensor}, scene, dataset, index)[name]


def _depth_pair(stage: tuple[DepthStage, Sensor]) -> tuple[DepthStage, Sensor]:
    return stage


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every array and plain value of nested records, with its name."""
    if is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from _leaves(getattr(value, field.name), f"{name}.{field.name}".lstrip("."))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield name, len(value)
        for number, entry in enumerate(value):
            yield from _leaves(entry, f"{name}[{number}]")
    else:
        yield name, value


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype.str}{value.shape}"
    return repr(value)


def _differences(stored: Any, again: Any, layer: str) -> Iterator[str]:
    """What differs, in words; nothing if all is equal."""
    for (name, a), (_, b) in zip(_leaves(stored, ""), _leaves(again, ""), strict=False):
        if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
            if repr(a) != repr(b):
                yield f"{layer}: {name} was {a}, is {b}"
        elif _text(a) != _text(b):
            yield f"{layer}: {name} was {_text(a)}, is {_text(b)}"
        elif a.tobytes() != b.tobytes():
            count = int((a != b).sum())
            yield f"{layer}: {count} of {a.size} values of {name} differ"
