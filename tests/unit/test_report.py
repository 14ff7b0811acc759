"""The report's parts: what is measured is kept, and the tables say what was measured."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
PAPER = json.loads((ROOT / "scripts/report/paper.json").read_text())


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch):
    """Import a module of the report, which is a script."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "report"))

    def get(name: str) -> ModuleType:
        monkeypatch.delitem(sys.modules, name, raising=False)
        return importlib.import_module(name)

    return get


def counting(folder: Path) -> list[str]:
    """A command that prints how often it ran."""
    program = (
        "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.open('a').write('x');"
        "print('{\"runs\": %d}' % len(p.read_text()))"
    )
    return [sys.executable, "-c", program, str(folder / "runs")]


def test_nothing_is_measured_twice_and_nothing_stale_is_kept(part, tmp_path: Path) -> None:
    """The same command on the same inputs runs once; on other inputs, or changed, again."""
    measured = part("measured")
    kept = measured.Measurements(tmp_path / "kept", inputs=["weights", "data"])
    command = counting(tmp_path)
    for _ in range(2):
        assert kept.get("one", command)["result"] == {"runs": 1}
    other = measured.Measurements(tmp_path / "kept", inputs=["weights", "more data"])
    assert other.get("one", command)["result"] == {"runs": 2}
    assert other.get("one", [*command, "--again"])["result"] == {"runs": 3}


def test_a_command_that_fails_is_told_and_tried_again(part, tmp_path: Path) -> None:
    """Its last line stands for the figure, and the next time it runs again."""
    kept = part("measured").Measurements(tmp_path / "kept", inputs=[])
    flag = tmp_path / "ready"
    program = f"import os, sys; print(7) if os.path.exists({str(flag)!r}) else sys.exit('not yet')"
    command = [sys.executable, "-c", program]
    assert kept.get("one", command)["error"] == "not yet"
    flag.touch()
    assert kept.get("one", command)["result"] == 7


def row(value: float) -> dict:
    names = ("viou", "ciou", "accc", "accg", "balanced_accg")
    figures = {name: value + k for k, name in enumerate(names)}
    return {**figures, "interval": {name: [v - 1, v + 1] for name, v in figures.items()},
            "by_scene": [{**figures, "frames": 12}, {**figures, "frames": 12}]}  # fmt: skip


def test_a_method_stands_above_the_papers_figures(part) -> None:
    """Every cell of a row is a figure with its interval; what was not measured says why;
    simulations that failed are counted beside the name.
    """
    tables = part("tables")
    result = {"full_sequence": row(80.0), "final": row(60.0), "fps": 21.04, "scenes": 64}
    found = {name: {"command": name, "result": dict(result)} for name in tables.METHODS}
    found["mpm"]["result"]["failed"] = 3
    found["gnn"] = {"command": "gnn", "error": "no particle network"}
    table = tables.method_table(found, PAPER["methods"])
    rows = {cells[0]: (kind, cells) for kind, cells in table.rows if kind != "paper"}
    kind, cells = rows["doughnet"]
    assert (kind, len(cells)) == ("here", len(table.head))
    assert (cells[1], cells[8], cells[-1]) == (
        "80.0 [79.0, 81.0]",
        "63.0 [62.0, 64.0]",
        "21.0",
    )
    assert "MLS-MPM + dynamic check (3 of 64 scenes failed)" in rows
    assert rows["particle network + static check"] == (
        "missing",
        ["particle network + static check", "no particle network"],
    )
    paper = [cells for kind, cells in table.rows if kind == "paper"]
    assert paper[0] == ["paper", "92.0", "90.5", "97.9", "98.6", "84.1", "75.1", "92.3", "90.3",
                        "22.1"]  # fmt: skip


def test_an_ablation_says_its_difference_and_whether_it_has_a_sign(part) -> None:
    """Twelve percent less on both scenes of both seeds is resolved, nothing is not."""
    tables = part("tables")
    found = {
        "full": [{"full_sequence": row(80.0)}] * 2,
        "explicit": [{"full_sequence": row(68.0)}] * 2,
        "one-step": [{"full_sequence": row(80.0)}] * 2,
    }
    table = tables.ablation_table(found, PAPER["recipes"])
    rows = {cells[0]: cells for kind, cells in table.rows if kind == "here"}
    assert rows["full, 2 seeds"][1] == "80.0 [80.0, 80.0]"
    assert rows["explicit, 2 seeds"][1] == "68.0 [68.0, 68.0]; -12.0 [-12.0, -12.0]"
    assert rows["one-step, 2 seeds"][1].endswith("(not resolved)")
    papers = [cells for kind, cells in table.rows if kind == "paper"]
    assert papers[1][1] == "76.3; -15.7"
