"""Dough on the table: which points it is, and in how many pieces."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import EXPECTED, ProcessingConfig
from doughdata.registry import require_package

__all__ = ["Dough", "check_expected", "find_dough", "rolls_turn"]

NONE = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class Dough:
    """What was found among candidate points, step by step."""

    inliers: Bool[np.ndarray, " points"]  # that outlier removal left
    voxels: Float64[np.ndarray, "voxels 3"]  # [m], means of the inliers in each voxel
    pieces: Int64[np.ndarray, " voxels"]  # 0, 1, ... or -1 in a crumb
    labels: Int64[np.ndarray, " points"]  # the same for all candidates, -1 for outliers as well

    @property
    def num_pieces(self) -> int:
        """Pieces found."""
        return int(self.pieces.max(initial=NONE)) + 1


def find_dough(points: Float64[np.ndarray, "points 3"], config: ProcessingConfig) -> Dough:
    """Statistical outlier removal, voxel downsampling and clusters of candidate points [m].

    Pieces are numbered by their middle along x, then y, of the frame that the points are in.
    """
    o3d = require_package("open3d", extra="render")
    inliers = np.zeros(len(points), bool)
    if len(points) > config.outlier_neighbours:
        _, kept = _cloud(o3d, points).remove_statistical_outlier(
            config.outlier_neighbours, config.outlier_ratio
        )
        inliers[np.asarray(kept, np.int64)] = True
    voxels, place = _voxels(points[inliers], config.voxel)
    if not len(voxels):  # which Open3D would warn about
        return Dough(
            inliers=inliers,
            voxels=voxels,
            pieces=np.zeros(0, np.int64),
            labels=np.full(len(points), NONE, np.int64),
        )
    clusters = np.asarray(_cloud(o3d, voxels).cluster_dbscan(config.cluster_distance, 1), np.int64)
    pieces = _in_order(voxels, clusters, config.cluster_share)
    labels = np.full(len(points), NONE, np.int64)
    labels[inliers] = pieces[place]
    return Dough(inliers=inliers, voxels=voxels, pieces=pieces, labels=labels)


def check_expected(dough: Dough, expect: str | None) -> None:
    """Refuse a first key frame that does not show what the user said.

    Raises:
        RecordingError: another number of pieces; a mismatch is an error, never a guess.
    """
    if expect is not None and dough.num_pieces != EXPECTED[expect]:
        sizes = np.bincount(dough.pieces[dough.pieces >= 0]).tolist()
        raise RecordingError(
            f"{expect} must be {EXPECTED[expect]} piece(s) in the first frame, found "
            f"{dough.num_pieces} (of {sizes} voxels): check --color, the height band, or "
            "--cluster-distance"
        )


def rolls_turn(
    voxels: Float64[np.ndarray, "voxels 3"], pieces: Int64[np.ndarray, " voxels"]
) -> float:
    """Turn [rad], in (-pi/2, pi/2], that lays two rolls side by side along x.

    The rolls' own direction is the first principal axis (PCA) of the points about the middle of
    their piece, seen from above; x is at a right angle to it. Of the two signs the one that turns
    less is taken, which is what makes it unique: -x stays within a right angle of where it was.
    """
    flat = np.concatenate(
        [voxels[pieces == k, :2] - voxels[pieces == k, :2].mean(axis=0) for k in (0, 1)]
    )
    along = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    turn = float(np.arctan2(-along[0], along[1]))  # of y; x follows
    if turn > np.pi / 2:
        return turn - np.pi
    return turn + np.pi if turn <= -np.pi / 2 else turn


def _voxels(
    points: Float64[np.ndarray, "points 3"], size: float
) -> tuple[Float64[np.ndarray, "voxels 3"], Int64[np.ndarray, " points"]]:
    """Means of the points in each voxel, and the voxel of each point."""
    if len(points) == 0:
        return np.zeros((0, 3)), np.zeros(0, np.int64)
    cells = np.floor(points / size).astype(np.int64)
    _, place, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    place = place.reshape(-1)
    sums = np.stack([np.bincount(place, points[:, k]) for k in range(3)], axis=1)
    return sums / count[:, None], place


def _in_order(
    voxels: Float64[np.ndarray, "voxels 3"], clusters: Int64[np.ndarray, " voxels"], share: float
) -> Int64[np.ndarray, " voxels"]:
    """Clusters numbered by x, then y, of their middle; -1 for those that are too small."""
    count = np.bincount(clusters[clusters >= 0]) if len(clusters) else np.zeros(0, np.int64)
    large = np.flatnonzero(count >= max(share * len(voxels), 1))
    middles = np.array([voxels[clusters == k, :2].mean(axis=0) for k in large]).reshape(-1, 2)
    pieces = np.full(len(voxels), NONE, np.int64)
    for number, k in enumerate(large[np.lexsort((middles[:, 1], middles[:, 0]))]):
        pieces[clusters == k] = number
    return pieces


def _cloud(o3d: Any, points: Float64[np.ndarray, "points 3"]) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
