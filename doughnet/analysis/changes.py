"""When the topology changes, told by how far the latents jump (DoughNet, supplement).

A frame's latents are averaged over the set; the distance to the next frame's, as a z-score of the
sequence, scores a change in between. A z-score of n values cannot exceed (n - 1) / sqrt(n),
so that short sequences need low thresholds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from doughnet.extras import train_package
from doughschemas import BadInputError

__all__ = ["Detector", "detector", "jump_scores"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Detector:
    """How well a score finds changes, over all thresholds."""

    false_positive_rate: Float64[np.ndarray, " roc"]
    true_positive_rate: Float64[np.ndarray, " roc"]
    area: float  # under the curve of both
    precision: Float64[np.ndarray, " thresholds"]
    recall: Float64[np.ndarray, " thresholds"]
    f1: float  # the best, in percent
    threshold: float  # of the best
    positive_rate: float  # share of changes, in percent: the precision of guessing


def jump_scores(mean: Float[np.ndarray, "frames width"]) -> Float64[np.ndarray, " steps"]:
    """z-score of the distance from every frame's mean latent to the next one's."""
    jumps = np.linalg.norm(np.diff(np.asarray(mean, np.float64), axis=0), axis=1)
    spread = jumps.std()
    return (jumps - jumps.mean()) / spread if spread > 0 else np.zeros_like(jumps)


def detector(
    scores: Sequence[Float64[np.ndarray, " steps"]], changed: Sequence[Bool[np.ndarray, " steps"]]
) -> Detector:
    """Judge scores of several scenes together.

    Raises:
        BadInputError: nothing or everything changes: there is nothing to tell apart.
    """
    metrics = train_package("sklearn.metrics")
    score, truth = np.concatenate(scores), np.concatenate(changed)
    if not 0 < truth.sum() < len(truth):
        raise BadInputError(
            f"{int(truth.sum())} of {len(truth)} steps change the topology; both kinds are needed"
        )
    false_positive, true_positive, _ = metrics.roc_curve(truth, score)
    precision, recall, thresholds = metrics.precision_recall_curve(truth, score)
    both = precision + recall
    f1 = np.where(both > 0, 2 * precision * recall / np.maximum(both, 1e-12), 0.0)
    best = int(f1[:-1].argmax())
    return Detector(
        false_positive_rate=false_positive,
        true_positive_rate=true_positive,
        area=float(metrics.auc(false_positive, true_positive)),
        precision=precision,
        recall=recall,
        f1=100 * float(f1[best]),
        threshold=float(thresholds[best]),
        positive_rate=100 * float(truth.mean()),
    )
