"""The page's tables: what was measured, with intervals, above what the paper says."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from doughnet.analysis.ablation import compare, per_scene

__all__ = ["Table", "ablation_table", "changes_table", "method_table", "model_table",
           "planning_table", "sizes_table"]  # fmt: skip

METRICS = ("viou", "ciou", "accc", "accg")
NAMES = {"viou": "VIoU", "ciou": "CIoU", "accc": "AccC", "accg": "AccG",
         "balanced_accg": "balanced AccG"}  # fmt: skip
METHODS = {
    "doughnet": "doughnet",
    "vpm": "VPM + static check",
    "mpm": "MLS-MPM + dynamic check",
    "gnn": "particle network + static check",
    "copy": "copy of the first frame",
}
MODEL_ROWS = ("reconstruction", "ceiling", "single_step", "full_sequence", "final",
              "copy_first_frame")  # fmt: skip
Found = Mapping[str, Any]  # a measurement: `command` and `result` or `error`


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Cells of text; rows of the paper are told apart."""

    head: Sequence[str]
    rows: Sequence[tuple[str, Sequence[str]]]  # kind (here, paper, missing) and cells
    commands: Sequence[str] = field(default_factory=tuple)


def method_table(found: Mapping[str, Found], paper: Found) -> Table:
    """Full sequences and final frames of all methods."""
    rows: list[tuple[str, Sequence[str]]] = []
    for name, label in METHODS.items():
        one = found[name]
        if "error" in one:
            rows.append(("missing", [label, one["error"]]))
        else:
            result = one["result"]
            failed = result.get("failed", 0)
            label += f" ({failed} of {result['scenes']} scenes failed)" if failed else ""
            cells = [*_cells(result["full_sequence"]), *_cells(result["final"])]
            rows.append(("here", [label, *cells, f"{result['fps']:.1f}"]))
        if name in paper:
            cells = [f"{v:.1f}" for part in ("full_sequence", "final") for v in paper[name][part]]
            rows.append(("paper", ["paper", *cells, f"{paper[name]['fps']:.1f}"]))
    head = [f"{where} {NAMES[m]}" for where in ("all steps,", "last step,") for m in METRICS]
    return Table(
        head=["percent", *head, "frames/s"],
        rows=rows,
        commands=[one["command"] for one in found.values()],
    )


def _cells(row: Found, metrics: Sequence[str] = METRICS) -> list[str]:
    return [interval_text(row[name], row["interval"][name]) for name in metrics]


def interval_text(value: float, interval: Sequence[float]) -> str:
    """A figure with its interval."""
    low, high = interval
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"


def model_table(found: Found) -> Table:
    """Every row of `evaluate`, also without labels given."""
    columns = (*METRICS, "balanced_accg")
    head = ["percent", *(NAMES[name] for name in columns)]
    if "error" in found:
        return Table(head=head, rows=[("missing", ["doughnet", found["error"]])],
                     commands=[found["command"]])  # fmt: skip
    result = found["result"]
    named = [(name, result[name]) for name in MODEL_ROWS if name in result]
    named += [(f"{name}, no labels given", row) for name, row in result["unlabelled"].items()]
    rows = [("here", [name.replace("_", " "), *_cells(row, columns)]) for name, row in named]
    return Table(head=head, rows=rows, commands=[found["command"]])


def ablation_table(
    found: Mapping[str, Sequence[Found]], paper: Found, *, row: str = "full_sequence"
) -> Table:
    """Means over seeds and scenes, and the difference from the full recipe on the same ones.

    Args:
        found: recipe -> what `evaluate` printed, one of each seed; `full` is compared with.
        paper: recipe -> row -> the four metrics.
        row: of the table of `evaluate`.
    """
    rows: list[tuple[str, Sequence[str]]] = []
    for name, tables in found.items():
        cells = [f"{name}, {len(tables)} seeds"]
        for metric in METRICS:
            seeds = min(len(tables), len(found["full"]))
            own, frames = per_scene(tables[:seeds], row, metric)
            base, _ = per_scene(found["full"][:seeds], row, metric)
            one = compare(own, base, frames)
            text = interval_text(one.value, one.interval)
            if name != "full":
                text += f"; {one.difference:+.1f} [{_pair(one.difference_interval)}]"
                text += "" if one.resolved else " (not resolved)"
            cells.append(text)
        rows.append(("here", cells))
        if name in paper:
            rows.append(("paper", ["paper", *_paper(paper, name, row)]))
    return Table(head=["percent", *(NAMES[m] for m in METRICS)], rows=rows)


def _pair(interval: Sequence[float]) -> str:
    return ", ".join(f"{value:+.1f}" for value in interval)


def _paper(paper: Found, name: str, row: str) -> list[str]:
    """The paper's figures; beside those of an ablation the difference."""
    texts = []
    for value, full in zip(paper[name][row], paper["full"][row], strict=True):
        texts.append(f"{value:.1f}" + ("" if name == "full" else f"; {value - full:+.1f}"))
    return texts


def planning_table(found: Found, paper: Found) -> Table:
    """How near plans come to the squeezes that made the goals."""
    head = ["", "here", "paper"]
    if "error" in found or "not_measured" in found.get("result", {}):
        line = found.get("error") or found["result"]["not_measured"]
        return Table(head=head, rows=[("missing", ["plans", line])], commands=[found["command"]])
    result = found["result"]
    names = {
        "goals": "held-out goals",
        "translation_mm": "translation, median [mm]",
        "rotation_deg": "rotation, median [degrees]",
        "opening_mm": "final opening, median [mm]",
        "tool_accuracy": "share of plans with the tool of the goal",
        "topology_reached": "share that reaches the goal's topology in the simulator",
        "viou": "VIoU of the simulated outcome, median [%]",
        "plan_s": "seconds a plan, median",
    }
    return Table(head=head, rows=_listed(names, result, paper), commands=[found["command"]])


def changes_table(found: Found, paper: Found) -> Table:
    """The detector of topological change."""
    head = ["", "here", "paper"]
    changes = found.get("result", {}).get("changes", {})
    if "f1" not in changes:
        line = found.get("error") or changes["not_measured"]
        return Table(head=head, rows=[("missing", ["changes", line])], commands=[found["command"]])
    names = {
        "f1": "best F1 [%]",
        "threshold": "at a z-score of",
        "positive_rate": "steps that change the topology [%]",
        "area": "area under the ROC curve",
        "key_frames": "key frames a scene",
    }
    return Table(head=head, rows=_listed(names, changes, paper), commands=[found["command"]])


def _listed(names: Mapping[str, str], here: Found, paper: Found) -> list[tuple[str, list[str]]]:
    """A row for every figure that was measured, by its label."""
    return [
        ("here", [label, str(here[name]), str(paper.get(name, ""))])
        for name, label in names.items()
        if name in here
    ]


def sizes_table(sizes: Mapping[str, Any], paper: Mapping[str, Any]) -> Table:
    """What is smaller here than there."""
    names = [*paper, *(name for name in sizes if name not in paper)]
    rows = [
        ("here", [name, str(sizes.get(name, "")), str(paper.get(name, "not said"))])
        for name in names
    ]
    return Table(head=["", "here", "paper"], rows=rows)
