"""Contact sheet of recordings: colour, depth and segments of a few key frames each."""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float64, UInt8

from doughdata.registry import require_package
from doughdata.view.panels import COLOURS
from doughschemas import SEGMENT_COMPONENT, SEGMENT_TABLE, SEGMENT_TOOL

__all__ = ["draw_recordings", "recorded_scenes"]

SENSOR = "recorded"
COLUMNS = 6
DOTS_PER_INCH = 150
CELL = (2.2, 1.65)  # [inch]
HEAD, SIDE = 0.5, 0.62  # [inch]
FLAT = {SEGMENT_TABLE: (0.86, 0.84, 0.79), SEGMENT_TOOL: (0.36, 0.39, 0.44)}
NOTHING = (1.0, 1.0, 1.0)
SPARSE = 0.2  # share of pixels with depth below which a view is one of scattered points


class RecordedDataset(Protocol):
    """What is needed of `doughdata.open_dataset(...)`."""

    @property
    def scenes(self) -> Any:
        """Table of scenes."""
        ...

    def frame(self, *, scene: int, frame: int) -> Any:
        """One key frame, with `.timestamp`, `.color()` and `.depth(sensor)`."""
        ...


def recorded_scenes(dataset: RecordedDataset) -> list[int]:
    """Scenes that a real camera recorded."""
    table = dataset.scenes
    pairs = zip(table["scene_index"].to_pylist(), table["split"].to_pylist(), strict=True)
    return [index for index, split in pairs if split == "real"]


def draw_recordings(dataset: RecordedDataset, scenes: Sequence[int]) -> Any:
    """A matplotlib figure: for each recording a block of rows, for each key frame a column."""
    figures = require_package("matplotlib.figure", extra="view")
    blocks = [(index, _columns(dataset, index)) for index in scenes]
    rows = [3 if columns[0][1] is not None else 2 for _, columns in blocks]
    size = (
        SIDE + CELL[0] * max(3, *(len(columns) for _, columns in blocks)) + 0.1,
        sum(HEAD + CELL[1] * count for count in rows) + 0.1,
    )
    figure = figures.Figure(figsize=size, dpi=DOTS_PER_INCH, facecolor="white")
    top = size[1] - 0.05
    for (index, columns), count in zip(blocks, rows, strict=True):
        _draw_block(figure, _title(dataset, index), columns, top)
        top -= HEAD + CELL[1] * count
    return figure


def _columns(dataset: RecordedDataset, index: int) -> list[tuple[float, Any, Any, Any]]:
    """Time, colour, depth and segments of the key frames that are shown."""
    table = dataset.scenes
    place = table["scene_index"].to_pylist().index(index)
    total = table["num_frames"][place].as_py()
    shown = sorted({round(x) for x in np.linspace(0, total - 1, min(total, COLUMNS))})
    columns = []
    for number in shown:
        frame = dataset.frame(scene=index, frame=number)
        views, color = frame.depth(SENSOR), frame.color()
        depth = views.depth[0] * views.depth_unit
        images = (None if color is None else color[0], depth, views.segments[0])
        columns.append((frame.timestamp, *_gathered(*images)))
    return columns


def _gathered(
    color: UInt8[np.ndarray, "rows columns 3"] | None,
    depth: Float64[np.ndarray, "rows columns"],
    segments: UInt8[np.ndarray, "rows columns"],
) -> tuple[Any, Any, Any]:
    """A view as it is; of the scattered pixels of a cloud, squares that hold one or two each."""
    seen = depth > 0
    if seen.mean() > SPARSE or not seen.any():
        return color, depth, segments
    size = math.ceil(1.3 / math.sqrt(seen.mean()))
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) // size for axis in (1, 0))
    place = tuple(index // size for index in np.nonzero(seen))
    place = (place[0] - rows[0], place[1] - columns[0])
    shape = (int(rows[-1] - rows[0]) + 1, int(columns[-1] - columns[0]) + 1)
    counts, sums = np.zeros(shape), np.zeros(shape)
    np.add.at(counts, place, 1)
    np.add.at(sums, place, depth[seen])
    most = np.zeros(shape, np.uint8)
    np.maximum.at(most, place, segments[seen])
    some = np.maximum(counts, 1)
    if color is None:
        return None, sums / some, most
    colors = np.zeros((*shape, 3))
    np.add.at(colors, place, color[seen])
    colors[counts == 0] = 255
    return (colors / some[..., None]).astype(np.uint8), sums / some, most


def _title(dataset: RecordedDataset, index: int) -> str:
    table = dataset.scenes
    place = table["scene_index"].to_pylist().index(index)
    name, total = (table[column][place].as_py() for column in ("scene_id", "num_frames"))
    count = f"{total} key frame" + ("" if total == 1 else "s")
    return f"scene {index}  \N{MIDDLE DOT}  {name}  \N{MIDDLE DOT}  recorded, {count}"


def _draw_block(figure: Any, title: str, columns: Sequence[tuple], top: float) -> None:
    width, height = figure.get_size_inches()
    figure.text(
        SIDE / width, (top - 0.05) / height, title, fontsize=9.5, fontweight="bold", va="top"
    )
    depths = np.concatenate([depth[depth > 0] for _, _, depth, _ in columns])
    low, high = np.percentile(depths, [1, 99]) if len(depths) else (0.0, 1.0)
    names = [name for name in ("colour", "depth", "segments") if _has(columns, name)]
    for row, name in enumerate(names):
        bottom = top - HEAD - CELL[1] * (row + 1)
        middle = (bottom + CELL[1] / 2) / height
        figure.text(0.3 / width, middle, name, fontsize=8, rotation=90, va="center", ha="center")
        for column, (time, color, depth, segments) in enumerate(columns):
            axes = figure.add_axes(
                (
                    (SIDE + CELL[0] * column + 0.03) / width,
                    (bottom + 0.03) / height,
                    (CELL[0] - 0.06) / width,
                    (CELL[1] - 0.06) / height,
                )
            )
            axes.set_axis_off()
            if row == 0:
                axes.set_title(f"{time:.2f} s", fontsize=7.5, pad=2)
            if name == "colour":
                axes.imshow(color, interpolation="nearest")
            elif name == "depth":
                shown = np.ma.masked_equal(depth, 0)
                axes.imshow(shown, cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest")
            else:
                axes.imshow(segment_colours(segments), interpolation="nearest")


def _has(columns: Sequence[tuple], name: str) -> bool:
    return name != "colour" or columns[0][1] is not None


def segment_colours(
    segments: UInt8[np.ndarray, "rows columns"],
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Segments as RGB: table, tool and pieces in the colours of the other views."""
    palette = np.tile(np.array(NOTHING), (256, 1))
    for segment, colour in FLAT.items():
        palette[segment] = colour
    pieces = np.arange(256 - SEGMENT_COMPONENT)
    palette[SEGMENT_COMPONENT:] = COLOURS[pieces % len(COLOURS)]
    return (palette * 255).astype(np.uint8)[segments]
