"""Cross-entropy search for a squeeze (de Boer et al. 2005), whatever it is scored by.

Squeezes are drawn from a normal distribution of place, turn and final opening, and a multinomial
one over tools; the best of them make the next distribution (DoughNet, section 5.4).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from doughschemas import BadInputError

__all__ = ["Round", "SearchConfig", "Squeeze", "search"]

REDRAWS = 20  # of what falls out of bounds, before it is put on the bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Squeeze:
    """What is searched for: one squeeze of a parallel gripper."""

    tool: str
    position: tuple[float, float]  # [m], world, middle of the gap
    yaw: float  # [rad]; 0 closes along world x
    opening: float  # [m], at the end


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchConfig:
    """Sizes and bounds; the paper's where it states them."""

    samples: int = 64
    elites: int = 8
    iterations: int = 10
    spread: float = 0.008  # [m], first standard deviation of both coordinates
    reach: float = 0.040  # [m], greatest of both
    turn_spread: float = float(np.radians(10))  # [rad]
    turn: float = float(np.radians(10))  # [rad], greatest; a quarter turn or more = any
    openings: tuple[float, float] = (0.0005, 0.020)  # [m]
    least: float = 0.02  # share of the first deviations that is always kept
    doubt: float = 0.5  # squeezes that every tool is credited with, so that none dies out at once
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.elites <= self.samples or self.iterations < 1:
            raise BadInputError(
                f"a search needs 1 <= elites <= samples and an iteration, got {self.elites}, "
                f"{self.samples} and {self.iterations}"
            )
        if not 0 < self.openings[0] < self.openings[1]:
            raise BadInputError(f"openings must rise from above 0 m, got {self.openings}")

    @property
    def any_turn(self) -> bool:
        """Whether every turn is allowed: half a turn on, the gripper is the same again."""
        return self.turn >= np.pi / 2

    @property
    def bounds(self) -> Float64[np.ndarray, "2 4"]:
        """Least and greatest x, y, yaw, opening."""
        turn = np.inf if self.any_turn else self.turn
        low = [-self.reach, -self.reach, -turn, self.openings[0]]
        return np.array([low, [self.reach, self.reach, turn, self.openings[1]]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One iteration: its best squeezes, best first."""

    squeezes: tuple[Squeeze, ...]
    scores: tuple[float, ...]
    shares: tuple[float, ...]  # of the tools, in the distribution that was drawn from


@dataclass(slots=True, kw_only=True)
class _Distribution:
    tools: tuple[str, ...]
    shares: Float64[np.ndarray, " tools"]
    mean: Float64[np.ndarray, " 4"]
    spread: Float64[np.ndarray, " 4"]

    @classmethod
    def first(cls, tools: Sequence[str], config: SearchConfig) -> "_Distribution":
        low, high = config.openings
        return cls(
            tools=tuple(tools),
            shares=np.full(len(tools), 1 / len(tools)),
            mean=np.array([0.0, 0.0, 0.0, (low + high) / 2]),
            spread=np.array([config.spread, config.spread, config.turn_spread, (high - low) / 2]),
        )

    def draw(
        self, count: int, config: SearchConfig, rng: np.random.Generator
    ) -> tuple[Int64[np.ndarray, " squeezes"], Float64[np.ndarray, "squeezes 4"]]:
        """Indices of tools, and rows of x, y, yaw, opening within bounds."""
        low, high = config.bounds
        rows = rng.normal(self.mean, self.spread, (count, 4))
        for _ in range(REDRAWS):
            out = (rows < low) | (rows > high)
            if not out.any():
                break
            rows[out] = rng.normal(self.mean, self.spread, (count, 4))[out]
        rows = np.clip(rows, low, high)
        if config.any_turn:
            rows[:, 2] = _half_turn(rows[:, 2])
        return rng.choice(len(self.tools), count, p=self.shares), rows

    def refit(
        self,
        tool: Int64[np.ndarray, " elites"],
        rows: Float64[np.ndarray, "elites 4"],
        first: "_Distribution",
        config: SearchConfig,
    ) -> None:
        if config.any_turn:  # about the best one, so that a mean makes sense
            rows = rows.copy()
            rows[:, 2] = rows[0, 2] + _half_turn(rows[:, 2] - rows[0, 2])
        counts = np.bincount(tool, minlength=len(self.tools)) + config.doubt / len(self.tools)
        self.shares = counts / counts.sum()
        self.mean = rows.mean(axis=0)
        self.spread = np.maximum(rows.std(axis=0), config.least * first.spread)


def _half_turn(yaw: Float64[np.ndarray, " squeezes"]) -> Float64[np.ndarray, " squeezes"]:
    """The same gripper poses with yaw within a quarter turn either way."""
    return (yaw + np.pi / 2) % np.pi - np.pi / 2


def search(
    score: Callable[[Sequence[Squeeze]], Float64[np.ndarray, " squeezes"]],
    tools: Sequence[str],
    config: SearchConfig,
) -> Iterator[Round]:
    """Search for the squeeze with the highest score, round by round.

    The best squeeze so far takes part in every round, so that no round's best is worse than the
    one before: the answer is the first squeeze of the last round.

    Args:
        score: of many squeezes at once; higher is better, NaN for one that cannot be carried out.
        tools: names to choose from.
        config: sizes and bounds.

    Raises:
        BadInputError: no tools; or no squeeze of a round has a score.
    """
    if not tools:
        raise BadInputError("a search needs at least one tool")
    rng = np.random.default_rng(config.seed)
    first = _Distribution.first(tools, config)
    now = _Distribution.first(tools, config)
    best: tuple[int, Float64[np.ndarray, " 4"]] | None = None
    for _ in range(config.iterations):
        tool, rows = now.draw(config.samples, config, rng)
        if best is not None:
            tool[0], rows[0] = best
        squeezes = [_squeeze(now.tools[t], row) for t, row in zip(tool, rows, strict=True)]
        scores = np.nan_to_num(np.asarray(score(squeezes), float), nan=-np.inf)
        order = np.argsort(-scores, kind="stable")[: config.elites]
        order = order[np.isfinite(scores[order])]
        if len(order) == 0:
            raise BadInputError(
                f"none of {len(squeezes)} squeezes can be carried out: the fingers begin in the "
                "dough; give other tools, or a start whose dough fits between them"
            )
        yield Round(
            squeezes=tuple(squeezes[k] for k in order),
            scores=tuple(scores[order].tolist()),
            shares=tuple(now.shares.tolist()),
        )
        best = int(tool[order[0]]), rows[order[0]]
        now.refit(tool[order], rows[order], first, config)


def _squeeze(tool: str, row: Float64[np.ndarray, " 4"]) -> Squeeze:
    x, y, yaw, opening = row.tolist()
    return Squeeze(tool=tool, position=(x, y), yaw=yaw, opening=opening)
