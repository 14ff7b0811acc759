"""A recording's key frame as tensors: those of a simulated one, as far as anybody can know them."""

from collections.abc import Mapping

import numpy as np

from doughdata.dataset import Frame
from doughdata.torch.sampling import NO_POINT, dough_points, query_points
from doughschemas import SEGMENT_COMPONENT

__all__ = ["recorded_arrays"]


def recorded_arrays(
    frame: Frame,
    sensor: str,
    view: int,
    rng: np.random.Generator,
    *,
    num_points: int,
    num_queries: int,
    num_tool_points: int,
    max_components: int,
) -> tuple[Mapping[str, np.ndarray], int]:
    """Arrays of a sample, and the number of pieces seen in this very frame.

    What nobody can measure is -1 (`query_labels`, `genus`), the queries are all uniform, and the
    fingers, whose shape is not recorded, are zeros.
    """
    views = frame.depth(sensor)
    points, point_labels = dough_points(views, view, num_points, rng)
    seen = views.segments[np.flatnonzero(views.view_index == view)[0]]
    pieces = np.unique(seen[seen >= SEGMENT_COMPONENT])
    arrays = {
        "points": points,
        "point_labels": point_labels,
        "queries": query_points((), num_queries, rng),
        "query_labels": np.full(num_queries, NO_POINT, np.int64),
        "tool_points": np.zeros((2, num_tool_points, 3)),
        "genus": np.full(max_components, NO_POINT, np.int64),
    }
    return arrays, len(pieces)
