"""The page of a plan: round by round the best squeezes, from above, over what they lead to."""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from doughcli.net_surfaces import from_above
from doughdata.view.panels import COLOURS

__all__ = ["plan_page"]

HALF = 60  # [mm], half the side of a picture
PIXEL = 2  # [mm], of the predicted dough
STYLE = """
body{font:14px system-ui,sans-serif;margin:24px;color:#222;max-width:1080px}
h1{font-size:20px}figure{display:inline-block;margin:0 12px 18px 0;width:200px;vertical-align:top}
svg{width:200px;height:200px;background:#f4f2ee;border-radius:6px}figcaption{font-size:12px}
table{border-collapse:collapse}td,th{padding:2px 10px 2px 0;text-align:left;font-weight:normal}
td{font-variant-numeric:tabular-nums}th{color:#666}
"""


def plan_page(
    plan: Any, shapes: Sequence[Any], start: Any, goal: Any, gripper: Any, found: dict[str, Any]
) -> str:
    """One self-contained page.

    Args:
        plan: a `doughnet.planner.Plan`.
        shapes: the predicted end of the best squeeze of every round (`doughnet.model.Shape`).
        start: where the plan begins (`Source`).
        goal: what it is to reach (`Source`).
        gripper: whose tools are drawn (`ToolGripper`).
        found: numbers for the table: what `plan.json` holds.
    """
    figures = [
        _figure(_dots(start), "start, as it is seen"),
        _figure(_dots(goal), "goal, as it is seen"),
    ]
    for number, (found_round, shape) in enumerate(zip(plan.rounds, shapes, strict=True), 1):
        drawing = _dough(shape) + "".join(
            _grippers(gripper, squeeze, 1.0 if k == 0 else 0.35)
            for k, squeeze in reversed(list(enumerate(found_round.squeezes)))
        )
        shares = ", ".join(
            f"{escape(name)} {share:.0%}"
            for name, share in zip(gripper.tools, found_round.shares, strict=True)
        )
        caption = f"round {number}: cosine {found_round.scores[0]:.4f}<br>{shares}"
        figures.append(_figure(drawing, caption))
    rows = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in _rows(found))
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>doughnet plan</title>'
        f"<style>{STYLE}</style></head><body><h1>Plan</h1><table>{rows}</table>"
        "<p>From above, 120 mm wide. Coloured: the dough that the round's best squeeze is "
        "predicted to leave, by component. Outlines: fingers at the final opening, the best one "
        "dark.</p>"
        f"{''.join(figures)}</body></html>\n"
    )


def _rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    squeeze = found["squeeze"]
    x, y = (1000 * value for value in squeeze["position"])
    rows = [
        ("start", found["start"]),
        ("goal", found["goal"]),
        ("tool", squeeze["tool"]),
        ("place", f"({x:.1f}, {y:.1f}) mm"),
        ("turn", f"{squeeze['yaw_deg']:.1f} degrees"),
        ("final opening", f"{1000 * squeeze['opening']:.1f} mm"),
        ("cosine with the goal", f"{found['score']:.4f}"),
    ]
    if result := found.get("verified"):
        rows.append(("carried out: genus", f"{result['genus']}, wanted {result['goal_genus']}"))
        if result["viou"] is not None:
            rows.append(("carried out: VIoU, CIoU", f"{result['viou']}, {result['ciou']} %"))
    return rows


def _figure(drawing: str, caption: str) -> str:
    box = f"{-HALF} {-HALF} {2 * HALF} {2 * HALF}"
    return (
        f'<figure><svg viewBox="{box}"><g transform="scale(1,-1)">{drawing}</g></svg>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _dots(source: Any) -> str:
    return "".join(
        f'<circle cx="{1000 * x:.1f}" cy="{1000 * y:.1f}" r="0.7" fill="{_colour(int(label))}"/>'
        for (x, y, _), label in zip(source.points, source.labels, strict=True)
        if label >= 0
    )


def _dough(shape: Any) -> str:
    """The topmost component over every square, in runs along x."""
    from doughnet.lattice import workspace_lattice

    lattice = workspace_lattice()
    labels, genus = shape.components()
    seen = from_above(labels.numpy()[::PIXEL, ::PIXEL], len(genus))
    x0, y0 = 1000 * lattice.origin[:2]
    parts = []
    for row in range(seen.shape[1]):
        line = seen[:, row]
        edges = np.flatnonzero(np.diff(line, prepend=-2, append=-2))
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if line[a] >= 0:
                parts.append(
                    f'<rect x="{x0 + PIXEL * (a - 0.5):.1f}" y="{y0 + PIXEL * (row - 0.5):.1f}" '
                    f'width="{PIXEL * (b - a)}" height="{PIXEL}" fill="{_colour(int(line[a]))}"/>'
                )
    return "".join(parts)


def _grippers(gripper: Any, squeeze: Any, opacity: float) -> str:
    last = gripper.poses(squeeze)[-1]
    depth, width = (1000 * side for side in _footprint(last.tool))
    parts = []
    for (x, y, _), (_, _, z, w) in zip(last.position, last.quaternion, strict=True):
        turn = np.degrees(2 * np.arctan2(z, w))
        parts.append(
            f'<rect x="0" y="{-width / 2:.2f}" width="{depth:.2f}" height="{width:.2f}" '
            f'fill="none" stroke="#222" stroke-width="0.8" opacity="{opacity}" '
            f'transform="translate({1000 * x:.2f},{1000 * y:.2f}) rotate({turn:.2f})"/>'
        )
    return "".join(parts)


def _footprint(tool: Any) -> tuple[float, float]:
    """Depth and width of a finger [m]."""
    if tool.mesh is None:
        return tool.depth, tool.width
    from doughdata.scenes.tools import finger_mesh

    low, high = finger_mesh(tool).bounds
    return float(high[0] - low[0]), float(high[1] - low[1])


def _colour(label: int) -> str:
    red, green, blue = (255 * COLOURS[label % len(COLOURS)][:3]).astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"
