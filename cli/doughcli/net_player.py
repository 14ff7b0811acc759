"""Simulator, check and mesher for the baseline that simulates what the model sees."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float32

from doughcli.build import build_stages
from doughcli.net_trial import shape_bodies
from doughdata import registry
from doughdata.dataset import Dataset, Frame
from doughdata.scene_work import simulate_scene
from doughdata.scenes.limits import check_scene
from doughschemas import (
    BadInputError,
    ComponentMeshes,
    FrameTopology,
    LabelGrid,
    Scene,
    SceneGraph,
)

__all__ = ["ScenePlayer", "dough_around"]


class ScenePlayer:
    """A `doughnet.baselines.simulated.Player` for scenes of a dataset with one action each."""

    def __init__(self, source: Dataset, *, preset: str = "draft") -> None:
        self.source, self.preset = source, preset

    def play(
        self, shape: Any, frames: Sequence[Frame]
    ) -> Sequence[tuple[LabelGrid, Sequence[int]]]:
        """Labels and genera of all key frames but the first.

        Raises:
            BadInputError: no dough in `shape`, or a scene with several actions.
            SceneError, SimulationError: it cannot be simulated.
        """
        before = self.source.scene(frames[0].scene_index)
        if len(before.actions) != 1:
            raise BadInputError(
                f"{before.scene_id}: expected one action, got {len(before.actions)}"
            )
        first = frames[0].frame_index
        action = replace(before.actions[0], opening_start=frames[0].tools.opening)
        count = self.source.num_frames - first  # the rest of the scene has as many key frames
        names = ("simulate", "topology", "mesh")
        stages = build_stages(
            names, preset=self.preset, frames=count, arch="cpu", mesher="dual-contouring"
        )
        simulator: Any = stages.simulator
        check: Any = stages.check
        mesher: Any = stages.mesher
        with TemporaryDirectory(prefix="doughnet-") as folder:
            bodies = tuple(shape_bodies(shape, Path(folder)))
            if not bodies:
                raise BadInputError(f"{before.scene_id}: the model sees no dough")
            scene: Scene = replace(
                before, scene_id=f"{before.scene_id}-seen", family="custom", bodies=bodies,
                actions=(action,), region="custom",
            )  # fmt: skip
            particles = simulate_scene(simulator, check_scene(scene))
            topology = check.check(scene, particles)
        found = []
        for frame in frames[1:]:
            number = frame.frame_index - first
            own = topology.frames[number]
            made = mesher.mesh(particles.positions[number], own, spacing=particles.spacing)
            found.append((made.label_grid, own.genus))
        return found


def dough_around(points: Float32[np.ndarray, "particles 3"], spacing: float) -> LabelGrid:
    """Labels on a 1 mm grid of the dough that particles [m] of one piece stand for.

    Raises:
        BadInputError: positions that are not finite.
    """
    count = len(points)
    one = FrameTopology(
        labels=np.zeros(count, np.uint8),
        genus=(0,),
        graph=SceneGraph(
            positions=points.mean(axis=0, keepdims=True),
            components=np.zeros(1, np.uint8),
            particles=np.array([count], np.int32),
            edges=np.zeros((0, 2), np.int32),
        ),
        contacts=np.zeros((0, 2), np.int32),
    )
    mesher = registry.load("meshers", "dual-contouring")()
    made: ComponentMeshes = mesher.mesh(points, one, spacing=spacing)
    return made.label_grid
