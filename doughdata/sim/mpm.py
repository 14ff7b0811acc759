"""The simulator: a scene's dough, squeezed between rigid fingers on a table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.scenes.limits import to_world
from doughdata.scenes.shapes import shape_of
from doughdata.sim._taichi import check_arch
from doughdata.sim.scene_run import SceneRun, run_together
from doughdata.sim.solver import Physics, Solver
from doughschemas import BadInputError, DoughError, Particles, Scene, SimulationError

__all__ = ["MpmConfig", "MpmSimulator", "draft", "fine", "standard"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MpmConfig:
    """Resolution and numerics. Where a number comes from stands behind it."""

    spacing: float = 0.002  # [m], of the particles at rest: the authors' 2 mm
    frames: int = 75  # key frames, uniform over a scene's duration, both ends included
    cells: float = 1.5625  # dx / spacing: the authors' 3.125 mm to 2 mm
    cfl: float = 0.5  # MLS-MPM is stable up to about 1; compressed dough carries faster waves
    settle: float = 0.1  # [s] under gravity before the first key frame
    jitter: float = 0.2  # of the spacing; a perfect lattice would break along its planes
    density_cap: float = 1.0  # the excess over 1 is volume that dough loses between wide fingers
    gravity: float = 9.81  # [m/s2]
    domain: float = 0.15  # [m], half side of the domain; the workspace ends at 0.1 m
    height: float = 0.12  # [m], top of the domain
    rest: float = (
        2e-3  # [m/s]; slower dough sleeps while no finger is near (moves final shapes 10 um)
    )
    arch: str = "auto"  # auto | cpu | cuda | vulkan
    batch: int = 32  # scenes at once on a GPU, which one alone leaves idle

    def __post_init__(self) -> None:
        check_arch(self.arch)
        limits = {
            "spacing": (0.0004, 0.005), "frames": (2, 100_000), "cells": (1.0, 2.5),
            "cfl": (0.01, 0.9), "settle": (0.0, 10.0), "jitter": (0.0, 0.45),
            "density_cap": (1.0, 10.0), "gravity": (0.0, 100.0), "domain": (0.1, 1.0),
            "height": (0.05, 1.0), "rest": (0.0, 1.0), "batch": (1, 1024),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            if not low <= getattr(self, name) <= high:
                raise BadInputError(
                    f"{name} must be within {low:g}..{high:g}, got {getattr(self, name)!r}"
                )


def draft() -> MpmConfig:
    """2 mm particles: the paper's resolution, seconds a scene."""
    return MpmConfig(spacing=0.002)


def standard() -> MpmConfig:
    """1.5 mm particles."""
    return MpmConfig(spacing=0.0015)


def fine() -> MpmConfig:
    """1 mm particles: eight times as many as in a draft, and steps half as long."""
    return MpmConfig(spacing=0.001)


class MpmSimulator:
    """MLS-MPM with Hencky elasticity, von Mises yield and Coulomb contact."""

    def __init__(self, config: MpmConfig | None = None) -> None:
        self.config = config or MpmConfig()

    @property
    def batch_size(self) -> int:
        """How many scenes `simulate_batch` should be given at once: one on the CPU."""
        return 1 if self.config.arch in ("auto", "cpu") else self.config.batch

    def simulate(self, scene: Scene, *, rng: np.random.Generator) -> Particles:
        """Simulate all actions of a scene; `rng` jitters the particles.

        Between two actions the gripper is lifted off and set down at the next pose at once. The
        same scene and generator state give the same bytes, on one machine; on a GPU to rounding.

        Raises:
            SceneError: a tool's mesh cannot be used.
            BadInputError: a body is too small for the spacing, or an `arch` that is not here.
            SimulationError: dough left the domain, the run became unstable, or a finger would be
                set down inside dough.
        """
        if self.batch_size > 1:
            (result,) = self.simulate_batch([scene], rngs=[rng])
            if isinstance(result, DoughError):
                raise result
            return result
        run = self._run(scene, rng)
        try:
            while (stretch := run.following()) is not None:
                run.cloud.advance(stretch.seconds, squeeze=stretch.squeeze)
        except SimulationError as error:
            raise run.named(error) from error
        return run.particles()

    def simulate_batch(
        self, scenes: Sequence[Scene], *, rngs: Sequence[np.random.Generator]
    ) -> list[Particles | DoughError]:
        """Simulate several scenes together: for each its particles, or the error that ended it.

        The key frames are those of `simulate`, to rounding. What is wrong with one scene does not
        change another.

        Raises:
            BadInputError: not one generator a scene.
        """
        if len(scenes) != len(rngs):
            raise BadInputError(f"expected a generator a scene: {len(scenes)}, got {len(rngs)}")
        results: dict[int, Particles | DoughError] = {}
        runs: dict[int, SceneRun] = {}
        for number, (scene, rng) in enumerate(zip(scenes, rngs, strict=True)):
            try:
                runs[number] = self._run(scene, rng)
            except DoughError as error:
                results[number] = error
        if runs:
            finished = run_together(list(runs.values()), arch=self.config.arch)
            results |= dict(zip(runs, finished, strict=True))
        return [results[number] for number in range(len(scenes))]

    def _run(self, scene: Scene, rng: np.random.Generator) -> SceneRun:
        c = self.config
        positions, object_ids = fill_bodies(scene, c, rng)
        cloud = Solver(
            positions, self._physics(scene), middle=scene.actions[0].position, arch=c.arch
        )
        timestamps = np.linspace(0.0, scene.duration, c.frames)
        return SceneRun(scene, cloud, object_ids, timestamps, settle=c.settle, rest=c.rest)

    def _physics(self, scene: Scene) -> Physics:
        c = self.config
        return Physics(
            material=scene.material,
            spacing=c.spacing,
            dx=c.cells * c.spacing,
            cfl=c.cfl,
            density_cap=c.density_cap,
            gravity=c.gravity,
            low=(-c.domain, -c.domain, 0.0),
            high=(c.domain, c.domain, c.height),
            table_friction=scene.table_friction,
        )


def fill_bodies(
    scene: Scene, config: MpmConfig, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "particles 3"], UInt8[np.ndarray, " particles"]]:
    """Jittered lattice points [m], world, inside every body, and the index of their body.

    Raises:
        BadInputError: a body holds no particle.
    """
    positions, object_ids = [], []
    for number, body in enumerate(scene.bodies):
        shape = shape_of(body)
        low, high = shape.bounds()
        axes = [
            np.arange(a + config.spacing / 2, b, config.spacing)
            for a, b in zip(low, high, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        points = points[shape.contains(points)]
        if len(points) == 0:
            raise BadInputError(f"body {number} is smaller than the spacing {config.spacing} m")
        points = points + rng.uniform(-config.jitter, config.jitter, points.shape) * config.spacing
        positions.append(to_world(points, body))
        object_ids.append(np.full(len(points), number, np.uint8))
    return np.concatenate(positions), np.concatenate(object_ids)
