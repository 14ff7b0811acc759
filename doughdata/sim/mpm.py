"""The simulator: a scene's dough, squeezed between rigid fingers on a table."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.scenes.limits import to_world
from doughdata.scenes.sdf import MARGIN, SignedDistanceGrid, finger_sdf
from doughdata.scenes.shapes import shape_of
from doughdata.scenes.tools import finger_poses, opening_at
from doughdata.sim._taichi import check_arch
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughschemas import Action, BadInputError, Particles, Scene, SimulationError, ToolPoses

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
    density_cap: float = 1.15  # below 1.1 dough between fingers stiffens, above 1.3 volume is lost
    gravity: float = 9.81  # [m/s2]
    domain: float = 0.15  # [m], half side of the domain; the workspace ends at 0.1 m
    height: float = 0.12  # [m], top of the domain
    rest: float = (
        2e-3  # [m/s]; slower dough sleeps while no finger is near (moves final shapes 10 um)
    )
    arch: str = "auto"  # auto | cpu; there are no kernels for a GPU

    def __post_init__(self) -> None:
        check_arch(self.arch)
        limits = {
            "spacing": (0.0004, 0.005), "frames": (2, 100_000), "cells": (1.0, 2.5),
            "cfl": (0.01, 0.9), "settle": (0.0, 10.0), "jitter": (0.0, 0.45),
            "density_cap": (1.0, 10.0), "gravity": (0.0, 100.0), "domain": (0.1, 1.0),
            "height": (0.05, 1.0), "rest": (0.0, 1.0),
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

    def simulate(self, scene: Scene, *, rng: np.random.Generator) -> Particles:
        """Simulate all actions of a scene; `rng` jitters the particles.

        The same scene and generator state give the same bytes, on one machine.

        Raises:
            SceneError: a tool's mesh cannot be used.
            BadInputError: a body is too small for the spacing, or an unknown `arch`.
            SimulationError: dough left the domain or the run became unstable.
        """
        try:
            return self._simulate(scene, rng)
        except SimulationError as error:
            raise SimulationError(f"scene {scene.scene_id!r}: {error}") from error

    def _simulate(self, scene: Scene, rng: np.random.Generator) -> Particles:
        positions, object_ids = fill_bodies(scene, self.config, rng)
        timestamps = np.linspace(0.0, scene.duration, self.config.frames)
        middle = scene.actions[0].position
        solver = Solver(positions, self._physics(scene), middle=middle, arch=self.config.arch)
        tools = [finger_sdf(tool) for tool in scene.tools]
        if self.config.settle > 0:
            solver.advance(self.config.settle)
        frames = [solver.positions]
        for begin, end in pairwise(timestamps):
            for a, b in pairwise(_breaks(scene, begin, end)):
                self._stretch(solver, _squeeze(scene, tools, a, b), b - a)
            frames.append(solver.positions)
        return Particles(
            positions=np.stack(frames),
            object_ids=object_ids,
            timestamps=timestamps,
            tool_poses=tool_poses(scene, timestamps),
            spacing=self.config.spacing,
        )

    def _stretch(self, solver: Solver, squeeze: Squeeze, seconds: float) -> None:
        """Advance by a stretch of linear finger motion; resting dough out of reach sleeps."""
        if _within_reach(solver, squeeze, seconds):
            solver.advance(seconds, squeeze=squeeze)
        elif float(np.abs(solver.v).max()) > self.config.rest:
            solver.advance(seconds)

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


def tool_poses(scene: Scene, timestamps: Float64[np.ndarray, " frames"]) -> ToolPoses:
    """Where both fingers are at each time [s]."""
    position, quaternion, opening, number = [], [], [], []
    for time in timestamps:
        index, begin = _action_at(scene, time)
        gap, _ = opening_at(scene.actions[index], time - begin)
        p, q = finger_poses(scene.actions[index], gap)
        position.append(p)
        quaternion.append(q)
        opening.append(gap)
        number.append(index)
    return ToolPoses(
        position=np.array(position),
        quaternion=np.array(quaternion),
        opening=np.array(opening),
        action=np.array(number, np.int32),
    )


def _action_at(scene: Scene, time: float) -> tuple[int, float]:
    """Index of the action under way, and when it began [s]; the last one at the very end."""
    begin = 0.0
    for index, action in enumerate(scene.actions):
        if time < begin + action.duration or index == len(scene.actions) - 1:
            return index, begin
        begin += action.duration
    raise SimulationError("a scene needs an action")


def _breaks(scene: Scene, begin: float, end: float) -> list[float]:
    """Times from `begin` to `end` [s] between which no finger changes its speed."""
    times, offset = [begin], 0.0
    for action in scene.actions:
        turns = [offset + turn for turn in _turns(action)]
        times.extend(turn for turn in turns if begin + 1e-9 < turn < end - 1e-9)
        offset += action.duration
    return [*times, end]


def _turns(action: Action) -> list[float]:
    """When a finger changes its speed, from the start of its action [s]."""
    close = (action.opening_start - action.opening_end) / (2 * action.speed)
    return sorted({close, close + action.hold, action.duration})


def _squeeze(scene: Scene, tools: list[SignedDistanceGrid], begin: float, end: float) -> Squeeze:
    index, offset = _action_at(scene, (begin + end) / 2)
    action = scene.actions[index]
    middle, speed = opening_at(action, (begin + end) / 2 - offset)
    return Squeeze(
        sdf=tools[action.tool],
        position=action.position,
        yaw=action.yaw,
        opening=middle + speed * (end - begin),
        rate=-2.0 * speed,
        friction=scene.tools[action.tool].friction,
    )


def _within_reach(solver: Solver, squeeze: Squeeze, seconds: float) -> bool:
    """Whether a finger's box, grown by the kernel support and its travel, holds a particle."""
    grow = 3.0 * solver.physics.dx + 0.5 * abs(squeeze.rate) * seconds
    size = (np.array(squeeze.sdf.values.shape) - 1) * squeeze.sdf.spacing
    low = squeeze.sdf.origin + MARGIN - grow
    high = squeeze.sdf.origin + size - MARGIN + grow
    c, s = np.cos(squeeze.yaw), np.sin(squeeze.yaw)
    r = solver.x[:, :2] - np.array(squeeze.position)
    along, lateral = c * r[:, 0] + s * r[:, 1], c * r[:, 1] - s * r[:, 0]
    for side in (1.0, -1.0):
        local = np.stack(
            [side * along - squeeze.opening / 2, side * lateral, solver.x[:, 2]], axis=1
        )
        if ((local > low) & (local < high)).all(axis=1).any():
            return True
    return False
