"""What was asked of a place in the dough, what the answer was, and when to ask again."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

if TYPE_CHECKING:
    from doughdata.topology.dynamic import DynamicConfig

__all__ = ["UNSURE", "Answers", "Decision", "Question"]

UNSURE = 0.35  # of the threshold; a decision nearer to it than this is unsure


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Does this patch hold, is this neck parted?"""

    kind: str  # merge | split
    centre: Float64[np.ndarray, " 3"]  # [m]
    size: int  # contact pairs of a patch, particles of a neck
    gap: float  # [spacings] of a patch, opening in spacings of a neck


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """One answered question."""

    question: Question
    paths: float  # disjoint paths left; of a neck, in units of resting dough
    passed: bool
    margin: float  # distance of `paths` from the threshold, in units of the threshold

    @property
    def kind(self) -> str:
        """What was decided about: merge or split."""
        return self.question.kind


@dataclass(slots=True)
class Answers:
    """Decisions of the present key frame, and those that stand until their place has changed."""

    config: "DynamicConfig"
    made: list[Decision] = field(default_factory=list)
    standing: list[Decision] = field(default_factory=list)

    def settled(self, question: Question) -> bool:
        """Whether the same place was asked before and has hardly changed since."""
        for known in self.standing:
            if not self._same_place(known.question, question):
                continue
            grown = question.kind == "merge" and question.size > self.config.grown * (
                known.question.size
            )
            return not grown and question.gap > known.question.gap - self._step(known)
        return False

    def decide(
        self,
        question: Question,
        paths: float,
        *,
        passed: bool,
        threshold: float,
        sharpness: float = 1.0,
        stands: bool = True,
    ) -> None:
        """Keep a decision; `sharpness` below 1 lessens the margin of an answer less resolved.

        A decision that did not pass stands until its place has changed, unless told otherwise.
        """
        margin = sharpness * abs(paths - threshold) / threshold
        made = Decision(question=question, paths=float(paths), passed=passed, margin=float(margin))
        self.made.append(made)
        if not stands:
            return
        self.standing = [d for d in self.standing if not self._same_place(d.question, question)]
        if not passed:
            self.standing.append(made)

    def _same_place(self, known: Question, question: Question) -> bool:
        away = float(np.linalg.norm(known.centre - question.centre))
        return known.kind == question.kind and away <= self.config.same_place

    def _step(self, known: Decision) -> float:
        """How much [spacings] a gap must close before it is worth asking again.

        More for a neck with many paths: they come and go over a fifth of the opening.
        """
        config = self.config
        if known.kind == "merge":
            return config.closer
        beyond = 1 - config.split_paths / max(known.paths, config.split_paths)
        return max(config.closer, config.closer_far * known.question.gap * beyond)
