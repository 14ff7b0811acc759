"""Pictures of the page, as data URIs: the page is one file."""

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from doughdata.registry import require_package
from doughdata.view.panels import COLOURS

__all__ = ["by_step", "embedded"]

METRICS = {"viou": "VIoU", "ciou": "CIoU", "accc": "AccC", "accg": "AccG"}
DASHED = ("vpm", "gnn", "copy")  # a topology that is read afterwards, or not at all


def by_step(found: Mapping[str, Any]) -> str:
    """Metrics of every method step by step; methods with a static check are dashed."""
    figure = require_package("matplotlib.figure", extra="view").Figure
    drawing = figure(figsize=(12, 3.2), layout="constrained")
    axes = drawing.subplots(1, len(METRICS), sharex=True)
    for axis, (metric, title) in zip(axes, METRICS.items(), strict=True):
        for number, (name, one) in enumerate(found.items()):
            if "result" not in one:
                continue
            values = [step[metric] for step in one["result"]["full_sequence"]["by_step"]]
            style = "--" if name in DASHED else "-"
            axis.plot(range(1, len(values) + 1), values, style, label=name,
                      color=COLOURS[number % len(COLOURS)])  # fmt: skip
        axis.set(title=title, xlabel="step")
    axes[0].set_ylabel("percent")
    axes[0].legend(fontsize=7)
    data = io.BytesIO()
    drawing.savefig(data, format="png", dpi=110)
    return _uri(data.getvalue())


def embedded(path: Path) -> str | None:
    """A PNG file, or None if there is none."""
    return _uri(path.read_bytes()) if path.is_file() else None


def _uri(data: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"
