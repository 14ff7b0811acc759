"""What a stage is: one protocol, one method, record in, record out.

Implementations live one per file, each beside its frozen config, and are found by name through
entry points (`doughdata.registry`). Nothing here depends on how a stage does its work.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8, UInt8

from doughschemas import (
    Camera,
    ComponentMeshes,
    DoughError,
    FrameTopology,
    Material,
    Particles,
    Scene,
    Topology,
)

__all__ = [
    "BatchSimulator",
    "DepthImage",
    "Executor",
    "Mesher",
    "PullApart",
    "PullProblem",
    "SceneFamily",
    "Sensor",
    "Shape",
    "Simulator",
    "TopologyCheck",
]

Item = TypeVar("Item")
Result = TypeVar("Result")


@runtime_checkable
class Shape(Protocol):
    """A solid at its own origin, lying on the plane z = 0. Its fields are the JSON parameters."""

    def contains(self, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
        """Whether each point [m] lies inside."""
        ...

    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Lowest and highest corner [m] of a box that holds the solid."""
        ...


@runtime_checkable
class SceneFamily(Protocol):
    """A distribution of scenes."""

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split; the same arguments give the same scene for ever."""
        ...


@runtime_checkable
class Simulator(Protocol):
    """Moves the dough of a scene."""

    def simulate(self, scene: Scene, *, rng: np.random.Generator) -> Particles:
        """Simulate all actions; `rng` places the particles.

        Raises:
            SimulationError: the run left its domain or blew up; the message names the reason.
        """
        ...


@runtime_checkable
class BatchSimulator(Simulator, Protocol):
    """A simulator that is better given several scenes at once, as on a GPU."""

    @property
    def batch_size(self) -> int:
        """How many scenes to give it at once; with 1 `simulate` is called instead."""
        ...

    def simulate_batch(
        self, scenes: Sequence[Scene], *, rngs: Sequence[np.random.Generator]
    ) -> Sequence[Particles | DoughError]:
        """For each scene its particles, or the error that ended it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class PullProblem:
    """A counterfactual: would these particles stay together if two sides were driven apart?"""

    positions: Float64[np.ndarray, "particles 3"]  # [m], world; the crop around a patch
    handles: Int8[np.ndarray, " particles"]  # 0 free, 1 and 2 driven
    direction: Float64[np.ndarray, " 3"]  # unit vector; handle 2 moves along it, handle 1 against
    distance: float  # [m], travelled by each handle
    speed: float  # [m/s], of each handle
    spacing: float  # [m], of the particles at rest
    material: Material = field(default_factory=Material)


@runtime_checkable
class PullApart(Protocol):
    """What the topology check needs of a simulator. Velocity and deformation start at zero."""

    def pull_apart(
        self, problems: Sequence[PullProblem]
    ) -> list[Float64[np.ndarray, "particles 3"]]:
        """Positions after each pull, without gravity, table or tools."""
        ...


@runtime_checkable
class TopologyCheck(Protocol):
    """Decides what is connected, from positions and tool poses alone."""

    def check(self, scene: Scene, particles: Particles) -> Topology:
        """Check every key frame, in order."""
        ...


@runtime_checkable
class Mesher(Protocol):
    """Turns the particles of one key frame into closed meshes, one a component."""

    def mesh(
        self,
        positions: Float32[np.ndarray, "particles 3"],
        topology: FrameTopology,
        *,
        spacing: float,
    ) -> ComponentMeshes:
        """Mesh one frame; `spacing` [m] is that of the particles at rest."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthImage:
    """What an ideal depth camera sees."""

    depth: Float32[np.ndarray, "rows columns"]  # [m] along the optical axis, 0 = no hit
    segments: UInt8[np.ndarray, "rows columns"]  # SEGMENT_* of doughschemas


@runtime_checkable
class Sensor(Protocol):
    """Turns an ideal depth image into what a real sensor would report."""

    def observe(
        self, image: DepthImage, camera: Camera, *, rng: np.random.Generator
    ) -> Float32[np.ndarray, "rows columns"]:
        """Noisy depth [m], 0 = invalid."""
        ...


class Executor(Protocol):
    """Maps a function over shards and yields results as they come, in any order."""

    name: ClassVar[str]

    def __enter__(self) -> "Executor": ...

    def __exit__(self, *error: Any) -> None: ...

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Call `function` (picklable) on every item."""
        ...
