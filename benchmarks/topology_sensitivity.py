"""How far the outcome hangs on each threshold of the dynamic check: every one moved by 20 %.

A moved check is the whole check again. Only what is certain to come out the same is not computed
twice: a pull with the same particles, ends and speed; the near pairs and the tetrahedra of the same
points; the reading of the same bonds, contacts and labels with the same sizes of holes.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from doughdata.sim.pull import MpmPullApart
from doughdata.stages import PullApart, PullProblem
from doughdata.topology import bonds
from doughdata.topology.alpha import AlphaComplex
from doughdata.topology.dynamic import DynamicCheck, DynamicConfig
from doughdata.topology.history import FrameState
from doughschemas import Particles, Scene

__all__ = ["Moved", "moved_thresholds", "threshold_sensitivity"]

FACTORS = (0.8, 1.2)
READ_WITH = ("loop_birth", "hole_radius", "loop_doubt")  # the thresholds of the readings
OF_STATES = ("pieces", "contacts", "bonds", "loops", "crossed", "changed")  # what readings go by


def moved_thresholds() -> dict[str, DynamicConfig]:
    """Every threshold moved by 20 %, one at a time."""
    given = DynamicConfig()
    values = {own.name: getattr(given, own.name) for own in fields(DynamicConfig)}
    return {
        f"{name} x {factor}": replace(given, **{name: value * factor})
        for name, value in values.items()
        if isinstance(value, float)
        for factor in FACTORS
    }


def threshold_sensitivity(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Share of scenes whose final components or genera change, by threshold moved by 20 %."""
    changed = Counter(name for row in rows for name in row["changed"])
    return {name: round(changed[name] / len(rows), 4) for name in moved_thresholds()}


@dataclass(slots=True)
class Remembered:
    """Pull tests that are not run twice."""

    puller: PullApart
    known: dict[bytes, np.ndarray] = field(default_factory=dict)

    def pull_apart(self, problems: Sequence[PullProblem]) -> list[np.ndarray]:
        """As `PullApart.pull_apart`."""
        keys = [_key(problem) for problem in problems]
        for key, problem in zip(keys, problems, strict=True):
            if key not in self.known:
                self.known[key] = self.puller.pull_apart([problem])[0]
        return [self.known[key] for key in keys]


@dataclass(slots=True)
class Once:
    """A function of points and numbers that is not computed twice."""

    function: Callable[..., Any]
    known: dict[bytes, Any] = field(default_factory=dict)

    def __call__(self, points: np.ndarray, *numbers: float) -> Any:
        """As the function."""
        key = _digest(numbers, points)
        if key not in self.known:
            self.known[key] = self.function(points, *numbers)
        return self.known[key]


@contextmanager
def computed_once() -> Iterator[None]:
    """Within it, near pairs and tetrahedra of the same points are not computed twice."""
    near, grown = bonds.near_keys, AlphaComplex.of
    bonds.near_keys, AlphaComplex.of = Once(near), Once(grown)
    try:
        yield
    finally:
        bonds.near_keys, AlphaComplex.of = near, grown


class Moved:
    """One scene's final genera under other thresholds."""

    def __init__(self, scene: Scene, particles: Particles) -> None:
        self.scene, self.particles = scene, particles
        self.puller = Remembered(MpmPullApart())
        usual = self._check(DynamicConfig())
        self.states = usual.follow(scene, particles)
        self.labels = usual.label(particles, self.states)
        self.genus = self._read(usual, self.states, self.labels)

    def end(self, config: DynamicConfig) -> list[int]:
        """Sorted genera of the last key frame's components."""
        check = self._check(config)
        other = [n for n in READ_WITH if getattr(config, n) != getattr(DynamicConfig(), n)]
        if other:
            return self._read(check, self.states, self.labels)
        states = check.follow(self.scene, self.particles)
        labels = check.label(self.particles, states)
        if _same(states, self.states) and _equal(labels, self.labels):
            return self.genus
        return self._read(check, states, labels)

    def changed(self) -> list[str]:
        """The moved thresholds with which the scene ends in another way."""
        moved = moved_thresholds()
        with computed_once():
            return [name for name in moved if self.end(moved[name]) != self.genus]

    def _check(self, config: DynamicConfig) -> DynamicCheck:
        return DynamicCheck(config, pull_apart=self.puller)

    def _read(
        self, check: DynamicCheck, states: Sequence[FrameState], labels: Sequence[np.ndarray]
    ) -> list[int]:
        return sorted(shape.genus for shape in check.read(self.particles, states, labels)[-1])


def _key(problem: PullProblem) -> bytes:
    rest = (problem.distance, problem.speed, problem.spacing, problem.material)
    return _digest(rest, problem.positions, problem.handles, problem.direction)


def _digest(rest: object, *arrays: np.ndarray) -> bytes:
    found = hashlib.sha256(repr(rest).encode())
    for array in arrays:
        found.update(repr((array.shape, array.dtype)).encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.digest()


def _same(states: Sequence[FrameState], others: Sequence[FrameState]) -> bool:
    return all(
        _equal([getattr(state, name) for state in states], [getattr(o, name) for o in others])
        for name in OF_STATES
    )


def _equal(values: Sequence[Any], others: Sequence[Any]) -> bool:
    return all(np.array_equal(value, other) for value, other in zip(values, others, strict=True))
