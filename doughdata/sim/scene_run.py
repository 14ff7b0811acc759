"""A scene under way, alone or beside others."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.sim.batch import BatchSolver
from doughdata.sim.script import Stretch, play, tool_poses
from doughdata.sim.solver import Solver
from doughschemas import DoughError, Particles, Scene, SimulationError

__all__ = ["SceneRun", "run_together"]


class SceneRun:
    """One scene: its cloud, what is next for it, and in the end its key frames."""

    def __init__(
        self,
        scene: Scene,
        cloud: Solver,
        object_ids: UInt8[np.ndarray, " particles"],
        timestamps: Float64[np.ndarray, " frames"],
        *,
        settle: float,
        rest: float,
    ) -> None:
        self.scene, self.cloud = scene, cloud
        self._object_ids, self._timestamps = object_ids, timestamps
        self._script = play(scene, cloud, timestamps, settle=settle, rest=rest)
        self._frames: list[np.ndarray] = []

    def following(self) -> Stretch | None:
        """The next stretch, once the one before has been made; None when there is none left.

        Raises:
            SimulationError: a finger would be set down inside dough.
        """
        try:
            return next(self._script)
        except StopIteration as end:
            self._frames = end.value
            return None

    def particles(self) -> Particles:
        """Key frames of a scene that came to its end."""
        return Particles(
            positions=np.stack(self._frames),
            object_ids=self._object_ids,
            timestamps=self._timestamps,
            tool_poses=tool_poses(self.scene, self._timestamps),
            spacing=self.cloud.physics.spacing,
        )

    def named(self, error: SimulationError) -> SimulationError:
        """The same error, which says what scene it ended."""
        named = SimulationError(f"scene {self.scene.scene_id!r}: {error}")
        named.__cause__ = error
        return named


def run_together(runs: Sequence[SceneRun], *, arch: str) -> list[Particles | DoughError]:
    """Play all scenes to their ends in one batch: particles, or the error that ended a scene."""
    batch = BatchSolver([run.cloud for run in runs], arch=arch)
    results: dict[int, Particles | DoughError] = {}
    while len(results) < len(runs):
        stretches: list[Stretch | None] = [None] * len(runs)
        for k, run in enumerate(runs):
            if k in results:
                continue
            try:
                stretches[k] = run.following()
            except DoughError as error:
                results[k] = run.named(error) if isinstance(error, SimulationError) else error
                continue
            if stretches[k] is None:
                results[k] = run.particles()
        batch.advance(stretches)
        for k, error in enumerate(batch.errors):
            if error is not None and k not in results:
                results[k] = runs[k].named(error)
    return [results[k] for k in range(len(runs))]
