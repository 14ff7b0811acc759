"""What a user of `doughnet` types and what comes back, on the closed-form scenes."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughcli.net import app
from doughdata import open_dataset
from doughdata.scenes import read_scenes
from doughnet import runs
from doughnet.config import PRESETS
from doughschemas import BadInputError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples
from tests.integration.conftest import command

PROGRAM = "import sys; from doughcli.net import main; sys.argv[0] = 'doughnet'; main()"
HEAVY = ("torch", "taichi", "open3d", "zarr", "scipy", "pyarrow", "lightning_fabric")
ROWS = {"reconstruction", "single_step", "full_sequence", "final", "copy_first_frame", "ceiling"}


def doughnet(*arguments: object, cwd: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run `doughnet` as a user would and check its exit code."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "120", "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == code, f"{arguments}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A dataset of two scenes of three key frames, all rendered."""
    path = tmp_path_factory.mktemp("scenes") / "dough"
    return write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri


@pytest.fixture(scope="module")
def trained(scenes: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both stages of `micro`, hardly trained."""
    folder = tmp_path_factory.mktemp("trained")
    common = ("--dataset", scenes, "--sensor", "none", "--out", "net", "--workers", 0, "--json")
    first = doughnet(
        "train", "autoencoder", "--preset", "micro", "--epochs", 2, *common, cwd=folder
    )
    assert json.loads(first.stdout)["steps"] > 0
    doughnet("train", "dynamics", "--batch-size", 2, "--epochs", 2, *common, cwd=folder)
    return folder / "net"


def test_evaluate_prints_the_whole_table(trained: Path, scenes: str) -> None:
    """`evaluate --json` prints one line with every row and column of the table, in percent."""
    done = doughnet("evaluate", "--dataset", scenes, "--weights", trained, "--split", "train",
                    "--sensor", "none",
                    "--json", cwd=trained)  # fmt: skip
    assert len(done.stdout.strip().splitlines()) == 1
    table = json.loads(done.stdout)
    assert table.keys() >= ROWS | {"inconsistent", "unlabelled"}
    for name in ROWS:
        assert table[name].keys() >= {"viou", "ciou", "accc", "accg", "balanced_accg"}
        assert all(0 <= table[name][k] <= 100 for k in ("viou", "ciou", "accc", "balanced_accg"))
    assert table["copy_first_frame"]["final_viou"] <= 100


def test_predict_saves_a_page(trained: Path, scenes: str, tmp_path: Path) -> None:
    """`predict` saves one self-contained page with three lanes and prints each frame's genera."""
    where = ("--dataset", scenes, "--sensor", "none", "--weights", trained)
    done = doughnet("predict", *where, "--scene", 1, "--save", "scene.html", "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert found["rolled_out"]
    assert all(frame["true_genus"] for frame in found["frames"])
    page = (tmp_path / "scene.html").read_text(encoding="utf-8")
    assert "observation, prediction, truth" in page
    assert "default-src 'none'" in page


@pytest.fixture(scope="module")
def goals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A ring as a mesh, and two halves of a ball as a cloud of two colours."""
    folder = tmp_path_factory.mktemp("goals")
    ring = trimesh.creation.torus(0.025, 0.008)
    ring.apply_translation([0, 0, 0.008]).export(folder / "ring.stl")
    ball = trimesh.creation.icosphere(radius=0.02).vertices + np.array([0, 0, 0.02])
    colours = np.where(ball[:, :1] > 0, [[255, 0, 0, 255]], [[0, 0, 255, 255]]).astype(np.uint8)
    trimesh.PointCloud(ball, colors=colours).export(folder / "halves.ply")
    photo = np.arange(4 * len(ball)).reshape(-1, 4).astype(np.uint8)
    trimesh.PointCloud(ball, colors=photo).export(folder / "photo.ply")
    return {path.name: str(path) for path in folder.iterdir()}


@pytest.mark.parametrize("goal", ["1:2", "ring.stl", "halves.ply"])
def test_plan_finds_a_squeeze(
    trained: Path, scenes: str, goals: dict[str, str], tmp_path: Path, goal: str
) -> None:
    """A key frame, a mesh and a coloured cloud are goals; the plan is a scene that can be played
    and a page that shows every round.
    """
    where = ("--dataset", scenes, "--sensor", "none", "--weights", trained, "--start", "1:0")
    small = ("--rounds", 2, "--samples", 6, "--elites", 2, "--tools", "scene,wide")
    done = doughnet("plan", *where, *small, "--goal", goals.get(goal, goal), "--save", "plan",
                    "--json", cwd=tmp_path)  # fmt: skip
    found = json.loads(done.stdout)
    assert -1 <= found["score"] <= 1
    (scene,) = read_scenes(tmp_path / "plan/scene.json")
    assert scene.actions[0].position == tuple(found["squeeze"]["position"])
    assert scene.tools[0].name == found["squeeze"]["tool"]
    assert scene.bodies == open_dataset(scenes).scene(1).bodies
    plan = json.loads((tmp_path / "plan/plan.json").read_text())
    assert [len(r["squeezes"]) for r in plan["rounds"]] == [2, 2]
    page = (tmp_path / "plan/plan.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 4


@pytest.mark.slow
def test_a_plan_is_carried_out(trained: Path, scenes: str, tmp_path: Path) -> None:
    """`--verify` simulates the plan and compares its end with the goal."""
    where = ("--dataset", scenes, "--sensor", "none", "--weights", trained, "--start", "1:0")
    small = ("--rounds", 1, "--samples", 4, "--elites", 1, "--goal", "1:2", "--verify", "--json")
    found = json.loads(doughnet("plan", *where, *small, cwd=tmp_path).stdout)["verified"]
    assert found["goal_genus"] == [0]
    assert 0 <= found["viou"] <= 100
    assert found["topology_reached"] == (found["genus"] == [0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--goal", "nothing.obj"), "expected SCENE:FRAME"),
        (("--goal", "photo.ply"), "doughdata convert"),
        (("--goal", "1:2", "--start", "1:2"), "no key frame is left"),
        (("--goal", "1:2", "--tools", "spoon"), "spoon"),
        (("--goal", "1:2", "--elites", 9, "--samples", 3), "elites"),
    ],
)
def test_plan_refuses_in_one_line(
    trained: Path, scenes: str, goals: dict[str, str], tmp_path: Path, arguments, message
) -> None:
    """What was expected, what came."""
    given = [goals.get(str(word), word) for word in arguments]
    start = () if "--start" in given else ("--start", "1:0")
    done = doughnet("plan", "--dataset", scenes, "--sensor", "none", "--weights", trained, *start,
                    *given, cwd=tmp_path, code=2)  # fmt: skip
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("method", ["vpm", "copy"])
def test_other_methods_are_scored(trained: Path, scenes: str, method: str) -> None:
    """`evaluate --method` prints full sequence and final frame with intervals, and its speed."""
    where = ("--dataset", scenes, "--weights", trained, "--split", "train", "--sensor", "none")
    table = json.loads(
        doughnet("evaluate", *where, "--method", method, "--json", cwd=trained).stdout
    )
    assert table["method"] == method
    assert table["fps"] > 0
    for row in (table["full_sequence"], table["final"]):
        low, high = row["interval"]["viou"]
        assert 0 <= low <= row["viou"] <= high <= 100
    refused = doughnet("evaluate", *where, "--method", "oracle", cwd=trained, code=2)
    assert "vpm" in refused.stderr


@pytest.mark.slow
def test_the_particle_network_is_trained_and_scored(
    trained: Path, scenes: str, tmp_path: Path
) -> None:
    """It is missed in one line before it was trained; then it has the rows of any other method."""
    trained = Path(shutil.copytree(trained, tmp_path / "net"))
    asked = ("evaluate", "--dataset", scenes, "--weights", trained, "--split", "train",
             "--sensor", "none", "--method", "gnn", "--json")  # fmt: skip
    missed = doughnet(*asked, cwd=trained, code=2)
    assert "doughnet train gnn" in missed.stderr
    done = doughnet("train", "gnn", "--dataset", scenes, "--out", trained, "--batch-size", 2,
                    "--epochs", 2, "--workers", 0, "--json", cwd=trained)  # fmt: skip
    assert json.loads(done.stdout)["steps"] == 2
    table = json.loads(doughnet(*asked, cwd=trained).stdout)
    assert (table["method"], table["scenes"]) == ("gnn", 2)
    assert set(table["final"]) == set(table["full_sequence"]) - {"by_step", "by_scene"}


def test_analyze_draws_and_measures(trained: Path, scenes: str, tmp_path: Path) -> None:
    """Pictures and one JSON file; changes are found among the rendered key frames."""
    where = ("--dataset", scenes, "--weights", trained, "--split", "train", "--sensor", "none")
    found = json.loads(doughnet("analyze", *where, "--save", "a", "--json", cwd=tmp_path).stdout)
    pictures = {"roc", "precision_recall", "tsne", "errors", "scales"}
    there = {path.name for path in (tmp_path / "a").iterdir()}
    assert there >= {f"{name}.png" for name in pictures} | {"analysis.json"}
    assert ("failures.png" in there) == (found["failures"] > 0)
    assert 0 < found["changes"]["f1"] <= 100
    assert len(found["by_step"]) == len(found["corrected"]) == found["changes"]["key_frames"]
    assert json.loads((tmp_path / "a/analysis.json").read_text())["scenes"] == found["scenes"] == 2


def test_a_run_reports_itself(trained: Path, scenes: str) -> None:
    """The report of a training holds the table, the curves of both stages and a card with each row
    of the table.
    """
    script = Path(__file__).parents[2] / "scripts" / "model_report.py"
    where = ["--run", str(trained), "--dataset", scenes, "--split", "train"]
    done = subprocess.run([sys.executable, script, *where], check=True, capture_output=True,
                          text=True)  # fmt: skip
    found = json.loads(done.stdout)
    assert found["losses"].keys() == {"autoencoder", "dynamics"}
    assert json.loads((trained / "table.json").read_text()) == found["table"]
    card = (trained / "README.md").read_text()
    assert all(f"| {name} |" in card for name in ROWS)
    assert "2 epochs a stage" in card
    assert (trained / "curve.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_report_puts_everything_on_one_page(trained: Path, scenes: str, tmp_path: Path) -> None:
    """`scripts/report` measures all methods, draws, and shows the figures that it measured; a
    second time it measures nothing again but what had failed.
    """
    script = Path(__file__).parents[2] / "scripts" / "report"
    where = ["--weights", str(trained), "--dataset", scenes, "--split", "train"]
    command = [sys.executable, script, *where, "--sensor", "none", "--goals", "1", "--out", "page"]
    subprocess.run(command, check=True, cwd=tmp_path, capture_output=True)
    page = (tmp_path / "page/index.html").read_text(encoding="utf-8")
    kept = {
        path.stem: json.loads(path.read_text()) for path in tmp_path.glob("page/measured/*.json")
    }
    assert "error" in kept["gnn"]  # it was not trained
    for name in ("doughnet", "vpm", "mpm", "copy"):
        full = kept[name]["result"]["full_sequence"]
        low, high = full["interval"]["viou"]
        assert f"{full['viou']:.1f} [{low:.1f}, {high:.1f}]" in page
    assert page.count("data:image/png") >= 6
    assert "doughnet train gnn" in page
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("page/measured/*.json")}
    subprocess.run(command, check=True, cwd=tmp_path, capture_output=True)
    again = {path.stem for path, then in before.items() if path.stat().st_mtime_ns != then}
    assert again == {"gnn"}


@pytest.mark.slow
def test_ablations_share_an_autoencoder_and_are_not_done_twice(scenes: str, tmp_path: Path) -> None:
    """A recipe of the dynamics has its seed's autoencoder, byte for byte, and other dynamics; the
    same command again trains and scores nothing.
    """
    script = Path(__file__).parents[2] / "scripts" / "ablations.py"
    options = [
        "--recipes",
        "full,relative",
        "--seeds",
        "1",
        "--minutes",
        "0.03",
        "--split",
        "train",
    ]
    where = ["--sensor", "none", "--dataset", scenes, "--out", "ablations", "--workers", "0"]
    command = [sys.executable, script, *options, *where, "--threads", "1"]
    for _ in range(2):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # nothing was left
    full, relative = (tmp_path / "ablations" / name for name in ("full-0", "relative-0"))
    weights = "autoencoder/weights.safetensors"
    assert (full / weights).read_bytes() == (relative / weights).read_bytes()
    tables = [json.loads((f / "evaluation.json").read_text()) for f in (full, relative)]
    assert tables[0]["reconstruction"]["viou"] == tables[1]["reconstruction"]["viou"]
    recorded = [json.loads((f / "dynamics/config.json").read_text()) for f in (full, relative)]
    assert [c["model"]["relative"] for c in recorded] == [False, True]


def test_weights_in_the_package_are_the_default(
    trained: Path, scenes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --weights the shipped ones are used, and one line says so if there are none."""
    monkeypatch.setattr(runs, "PRETRAINED", tmp_path / "pretrained")
    page = tmp_path / "page.html"
    arguments = ["predict", "--dataset", scenes, "--sensor", "none", "--save", str(page)]
    with pytest.raises(BadInputError, match="ships no trained weights yet"):
        app(arguments)
    assert not page.exists()
    shutil.copytree(trained / "dynamics", tmp_path / "pretrained" / "tiny")
    app(arguments, standalone_mode=False)
    assert page.exists()
    for name in runs.SHIPPED:  # a wheel carries what lies there, and a preset has that name
        assert name in PRESETS


def test_predict_reconstructs_a_recording(trained: Path, tmp_path: Path) -> None:
    """Of a converted recording, each frame is reconstructed from its own view, without a truth."""
    cloud = Path(__file__).parents[1] / "data" / "recordings" / "dough_ring.ply"
    command("convert", cloud, "--dataset", "real", cwd=tmp_path)
    done = doughnet("predict", "--dataset", "real", "--weights", trained, "--save", "real.html",
                    "--json", cwd=tmp_path)  # fmt: skip
    found = json.loads(done.stdout)
    assert not found["rolled_out"]
    assert [frame["true_genus"] for frame in found["frames"]] == [None]
    assert "from its own view" in (tmp_path / "real.html").read_text(encoding="utf-8")


def test_resuming_is_asked_for(trained: Path, scenes: str) -> None:
    """A training is not overwritten; --resume of a finished one does no step."""
    where = ("--dataset", scenes, "--sensor", "none", "--out", trained, "--workers", 0)
    common = ("train", "autoencoder", "--preset", "micro", *where, "--epochs", 2, "--json")
    refused = doughnet(*common, cwd=trained, code=2)
    assert "--resume goes on" in refused.stderr
    before = (trained / "autoencoder" / "weights.safetensors").read_bytes()
    doughnet(*common, "--resume", cwd=trained)
    assert (trained / "autoencoder" / "weights.safetensors").read_bytes() == before


def test_help_imports_nothing_heavy() -> None:
    """`doughnet --help` loads none of the heavy packages, and every command has an example."""
    code = (
        "import sys; sys.argv = ['doughnet', '--help']\nfrom doughcli.net import app, main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "assert all('xample' in c.epilog for c in app.registered_commands)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "evaluate" in done.stdout
    assert done.stderr.strip() == "[]"


BAD = {
    "stage": (("train", "everything"), "unknown stage"),
    "preset": (("train", "autoencoder", "--preset", "mikro"), "did you mean 'micro'"),
    "budget": (("train", "autoencoder", "--epochs", "1", "--minutes", "1"), "either"),
    "order": (("train", "dynamics", "--epochs", "1"), "doughnet train autoencoder"),
    "weights": (("evaluate", "--weights", "nothing"), "holds no weights"),
    "page": (("predict", "--save", "x.png"), ".html"),
    "split": (("evaluate", "--split", "val"), "split must be"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_usage_is_told(
    what: str, scenes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong name or a missing thing is an error that says what to do; nothing is made."""
    arguments, message = BAD[what]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInputError, match=re.escape(message)):
        app([*arguments, "--dataset", scenes, *(() if what == "page" else ("--sensor", "none"))])
    assert list(tmp_path.iterdir()) == []


def test_an_error_is_one_line(tmp_path: Path) -> None:
    """What is told stands in one line on stderr, with exit code 2."""
    done = doughnet("evaluate", "--weights", "nothing", cwd=tmp_path, code=2)
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("doughnet: nothing holds no weights")
