"""The counterfactual: would these particles stay together if two sides were driven apart?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from doughdata.sim.solver import Physics, Solver
from doughdata.stages import PullProblem
from doughschemas import BadInputError

__all__ = ["MpmPullApart", "PullConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PullConfig:
    """Numerics of a pull test."""

    cells: float = 1.5625  # dx / spacing: 2.0 sticks, 1.25 breaks thin necks
    cfl: float = 0.4  # as `MpmConfig.cfl`
    density_cap: float = 1.15  # what the check's thresholds were found with
    arch: str = "auto"  # as `MpmConfig.arch`


class MpmPullApart:
    """The simulator's own kernels without gravity, table and tools; handles have a set velocity."""

    def __init__(self, config: PullConfig | None = None) -> None:
        self.config = config or PullConfig()

    def pull_apart(
        self, problems: Sequence[PullProblem]
    ) -> list[Float64[np.ndarray, "particles 3"]]:
        """Positions [m] after each pull, in the order given; velocity and strain start at zero.

        The answer does not depend on the order of the particles, and only by rounding on where in
        the world the crop lies and on its yaw.

        Raises:
            BadInputError: a direction is no unit vector, or an array has the wrong length.
            SimulationError: a pull became unstable.
        """
        return [self._pull(problem) for problem in problems]

    def _pull(self, problem: PullProblem) -> Float64[np.ndarray, "particles 3"]:
        _check(problem)
        if len(problem.positions) == 0:
            return problem.positions.astype(np.float64)
        axes = _frame(problem.direction)
        turned = problem.positions @ axes.T
        centre = (turned.min(axis=0) + turned.max(axis=0)) / 2
        order = np.lexsort(turned.T)  # sums in single precision follow the order
        local = turned[order] - centre
        room = problem.distance + 4 * self.config.cells * problem.spacing
        physics = Physics(
            material=problem.material,
            spacing=problem.spacing,
            dx=self.config.cells * problem.spacing,
            cfl=self.config.cfl,
            density_cap=self.config.density_cap,
            gravity=0.0,
            low=tuple(local.min(axis=0) - room),
            high=tuple(local.max(axis=0) + room),
            table_friction=None,
        )
        solver = Solver(
            local,
            physics,
            handles=problem.handles[order],
            pull=(problem.speed, 0.0, 0.0),
            arch=self.config.arch,
        )
        solver.advance(problem.distance / problem.speed)
        pulled = np.empty_like(turned)
        pulled[order] = solver.positions
        return (pulled + centre) @ axes


def _frame(direction: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Rows: the pull, a horizontal vector across it, and the third; so that yaw changes nothing."""
    up = np.array([0.0, 0.0, 1.0])
    if abs(direction[2]) > 0.9:
        up = np.array([1.0, 0.0, 0.0])
    across = np.cross(up, direction)
    across /= np.linalg.norm(across)
    return np.stack([direction, across, np.cross(direction, across)])


def _check(problem: PullProblem) -> None:
    if len(problem.handles) != len(problem.positions):
        raise BadInputError(
            f"a pull needs one handle a particle: {len(problem.positions)} particles, "
            f"{len(problem.handles)} handles"
        )
    if abs(float(np.linalg.norm(problem.direction)) - 1.0) > 1e-6:
        raise BadInputError(f"a pull's direction must be a unit vector, got {problem.direction}")
    if not (problem.speed > 0 and problem.distance > 0 and problem.spacing > 0):
        raise BadInputError("a pull's speed, distance and spacing must be above 0")
