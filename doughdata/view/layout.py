"""Lays out panels on one page: a block for each scene, a column for each key frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from doughdata.registry import require_package
from doughdata.view.panels import (
    Picture,
    depth_crop,
    draw_depth,
    draw_graph,
    draw_mesh,
    draw_particles,
)
from doughdata.view.projection import View
from doughschemas import BadInputError, TopologyEvent

__all__ = ["SceneStrip", "draw_sheet"]

DOTS_PER_INCH = 150
CELL = (2.2, 1.65)  # [inch], width and height of a panel
HEAD = 0.55  # [inch], for the titles of a scene
SIDE = 0.62  # [inch], for the names of the rows


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneStrip:
    """One scene's block of the sheet: a column for each picture."""

    title: str
    frames: tuple[int, ...]
    times: tuple[float, ...]  # [s]
    pictures: tuple[Picture, ...]
    events: tuple[TopologyEvent, ...] = ()
    sensor: str = ""


def draw_sheet(strips: Sequence[SceneStrip], *, caption: str = "") -> Any:
    """A matplotlib figure of the strips; a row that no picture of a strip fills is left out.

    Raises:
        BadInputError: there is nothing to draw.
    """
    figures = require_package("matplotlib.figure", extra="view")
    if not strips or not all(strip.pictures for strip in strips):
        raise BadInputError("nothing to draw: at least one scene with one key frame is needed")
    columns = max(len(strip.pictures) for strip in strips)
    heights = [HEAD + CELL[1] * len(_rows(strip)) for strip in strips]
    size = (SIDE + columns * CELL[0] + 0.1, sum(heights) + 0.35)
    figure = figures.Figure(figsize=size, dpi=DOTS_PER_INCH, facecolor="white")
    top = size[1] - 0.05
    for strip, height in zip(strips, heights, strict=True):
        _draw_strip(figure, strip, top)
        top -= height
    figure.text(SIDE / size[0], 0.08 / size[1], caption, fontsize=7, color="#666666", va="bottom")
    return figure


def _rows(strip: SceneStrip) -> list[str]:
    """The rows that at least one picture fills."""
    pictures = strip.pictures
    present = {
        "particles": True,
        "mesh": any(picture.meshes is not None for picture in pictures),
        "depth": any(picture.depth is not None for picture in pictures),
        "scene graph": any(picture.topology is not None for picture in pictures),
    }
    return [name for name, there in present.items() if there]


def _draw_strip(figure: Any, strip: SceneStrip, top: float) -> None:
    """Draw one scene's block; `top` [inch] is its upper edge, counted from the figure's bottom."""
    width, height = figure.get_size_inches()
    view, window = View(), _window(strip, View())
    crop = depth_crop(strip.pictures)
    figure.text(
        SIDE / width, (top - 0.05) / height, strip.title, fontsize=9.5, fontweight="bold", va="top"
    )
    for row, name in enumerate(_rows(strip)):
        bottom = top - HEAD - (row + 1) * CELL[1]
        label = f"depth\n({strip.sensor})" if name == "depth" and strip.sensor else name
        figure.text(
            (SIDE - 0.12) / width, (bottom + CELL[1] / 2) / height, label, rotation=90,
            ha="center", va="center", multialignment="center", fontsize=8, color="#444444",
        )  # fmt: skip
        for column, picture in enumerate(strip.pictures):
            box = (SIDE + column * CELL[0] + 0.03, bottom + 0.03, CELL[0] - 0.06, CELL[1] - 0.06)
            axes = figure.add_axes(
                (box[0] / width, box[1] / height, box[2] / width, box[3] / height)
            )
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(color="#c9c5bc", linewidth=0.6)
            if name == "depth":
                draw_depth(axes, picture, crop)
            else:
                axes.set(xlim=window[0], ylim=window[1])
                DRAW[name](axes, picture, view)
            if row == 0:
                _head(axes, strip, column)


def _head(axes: Any, strip: SceneStrip, column: int) -> None:
    """Two lines over a column: frame and time; c and g, events since the column before."""
    frame, topology = strip.frames[column], strip.pictures[column].topology
    since = strip.frames[column - 1] if column else -1
    axes.text(
        0.0, 1.03, f"frame {frame}  \N{MIDDLE DOT}  {strip.times[column]:.2f} s",
        transform=axes.transAxes, fontsize=7, color="#777777", va="bottom",
    )  # fmt: skip
    if topology is None:
        return
    genus = ",".join(map(str, topology.genus)) or "\N{EN DASH}"
    axes.text(
        1.0, 1.03, f"c = {topology.num_components}   g = {genus}", transform=axes.transAxes,
        fontsize=8, fontweight="bold", ha="right", va="bottom",
    )  # fmt: skip
    happened = [event for event in strip.events if since < event.frame <= frame]
    badges = [(text, "#2b6cb0") for text in _event_texts(happened)]
    if topology.ambiguous:
        badges.append((f"ambiguous: {topology.ambiguous_reason}"[:38], "#b7791f"))
    for line, (text, colour) in enumerate(badges):
        axes.text(
            0.03, 0.96 - 0.115 * line, text, transform=axes.transAxes, fontsize=6.5, color="white",
            va="top", zorder=9, bbox={"facecolor": colour, "pad": 1.8, "linewidth": 0},
        )  # fmt: skip


def _event_texts(events: Sequence[TopologyEvent]) -> list[str]:
    """One line a kind: `split @ 41`, or `self-merge @ 51-54 (4)` for several."""
    texts = []
    for kind in dict.fromkeys(event.kind for event in events):
        frames = [event.frame for event in events if event.kind == kind]
        first, last, name = min(frames), max(frames), kind.replace("_", "-")
        span = f"{first}" if first == last else f"{first}\N{EN DASH}{last}"
        texts.append(f"{name} @ {span}" + (f" ({len(frames)})" if len(frames) > 1 else ""))
    return texts


def _window(strip: SceneStrip, view: View) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits [m] of the flat pictures: all dough of the strip, with a margin, undistorted."""
    points = np.concatenate([picture.positions for picture in strip.pictures])
    flat, _ = view.project(points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, size = (low + high) / 2, (high - low) * 1.25 + 0.01
    aspect = (CELL[0] - 0.06) / (CELL[1] - 0.06)
    half_height = max(size[1], size[0] / aspect) / 2
    half_width = half_height * aspect
    return (
        (middle[0] - half_width, middle[0] + half_width),
        (middle[1] - half_height, middle[1] + half_height),
    )


DRAW = {"particles": draw_particles, "mesh": draw_mesh, "scene graph": draw_graph}
