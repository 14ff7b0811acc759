"""One scene through one stage: what is read, which seed is used, what comes out."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from doughdata.dataset import Dataset
from doughdata.mesh.sequence import mesh_frames
from doughdata.render.depth import DepthStage
from doughdata.seeds import seed_sequence
from doughdata.stages import BatchSimulator, Mesher, Sensor, Simulator, TopologyCheck
from doughschemas import ComponentMeshes, DepthViews, DoughError, Particles, Scene, Topology

__all__ = ["check_scene", "mesh_scene", "render_scene", "simulate_scene", "simulate_scenes"]


def simulate_scene(simulator: Simulator, scene: Scene) -> Particles:
    """Simulate with the scene's own seed."""
    return simulator.simulate(scene, rng=_generator(scene))


def simulate_scenes(
    simulator: BatchSimulator, scenes: Mapping[int, Scene]
) -> dict[int, Particles | DoughError]:
    """Simulate scenes in batches: for each its particles, or the error that ended it."""
    results: dict[int, Particles | DoughError] = {}
    indices = list(scenes)
    for start in range(0, len(indices), simulator.batch_size):
        some = indices[start : start + simulator.batch_size]
        made = simulator.simulate_batch(
            [scenes[index] for index in some], rngs=[_generator(scenes[index]) for index in some]
        )
        results |= dict(zip(some, made, strict=True))
    return results


def _generator(scene: Scene) -> np.random.Generator:
    return np.random.default_rng(seed_sequence(scene.seed, scene.scene_id, "simulate"))


def check_scene(check: TopologyCheck, scene: Scene, dataset: Dataset, index: int) -> Topology:
    """Check the particles that the dataset holds."""
    return check.check(scene, dataset.read_particles(index))


def mesh_scene(mesher: Mesher, dataset: Dataset, index: int) -> list[ComponentMeshes]:
    """Mesh every key frame of the particles and labels that the dataset holds."""
    particles, topology = dataset.read_particles(index), dataset.read_topology(index)
    return mesh_frames(mesher, particles, topology)


def render_scene(
    stage: DepthStage, sensors: Mapping[str, Sensor], scene: Scene, dataset: Dataset, index: int
) -> dict[str, DepthViews]:
    """Depth of the meshes that the dataset holds, by sensor name."""
    poses = dataset.read_particles(index).tool_poses
    return stage.views(scene, poses, _SceneMeshes(dataset, index), sensors=sensors)


class _SceneMeshes(Mapping[int, ComponentMeshes]):
    """The meshes of one scene, read frame by frame when asked for."""

    def __init__(self, dataset: Dataset, scene: int) -> None:
        self._frame: Callable[[int], ComponentMeshes] = lambda k: dataset.read_meshes(scene, k)
        self._length = dataset.num_frames

    def __getitem__(self, frame: int) -> ComponentMeshes:
        return self._frame(frame)

    def __iter__(self) -> Iterator[int]:
        return iter(range(self._length))

    def __len__(self) -> int:
        return self._length
