"""What a user types and what comes back."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from doughcli.generate import scenes_made
from doughdata import open_dataset
from doughdata.sim._taichi import gpu_present
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples
from tests.integration.conftest import command

HEAVY = ("torch", "taichi", "open3d", "zarr", "scipy", "pyarrow", "matplotlib")


def test_help_imports_nothing_heavy() -> None:
    """`doughdata --help` must answer at once, so it loads none of the heavy packages."""
    code = (
        "import sys; sys.argv = ['doughdata', '--help']\n"
        "from doughcli.app import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "generate" in done.stdout
    assert done.stderr.strip() == "[]"


COMMANDS = (
    *("generate", "render", "validate", "reproduce", "info", "stats", "view", "export"),
    *("plugins", "scenes", "gc", "merge", "subset", "split", "card", "convert", "migrate"),
)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, tmp_path: Path) -> None:
    """Each command has a help page with an example."""
    assert "Example" in command(name, "--help", cwd=tmp_path).stdout


def test_no_command_is_untested() -> None:
    """The list above holds every command that the application has."""
    from doughcli.app import app

    registered = {c.name for c in app.registered_commands} | {g.name for g in app.registered_groups}
    assert registered == set(COMMANDS)


BAD = {
    "family": (("generate", "--scenes", "donut"), 2, "did you mean 'doughnut'"),
    "file": (("generate", "--scenes", "nothing.json"), 2, "not found"),
    "stage": (("generate", "--scenes", "rolls", "--stages", "bake"), 2, "unknown stage 'bake'"),
    "preset": (("generate", "--scenes", "rolls", "--preset", "ultra"), 2, "unknown preset"),
    "arch": (("generate", "--scenes", "rolls", "--arch", "tpu"), 2, "unknown arch"),
    "mesher": (("generate", "--scenes", "rolls", "--mesher", "cubes"), 2, "unknown mesher"),
    "split": (("generate", "--scenes", "rolls", "--split", "val"), 2, "unknown split"),
    "executor": (("generate", "--scenes", "rolls", "--executor", "gpu"), 2, "unknown executor"),
    "sensor": (("render", "--noise", "realsence"), 2, "did you mean 'realsense'"),
    "no dataset": (("render", "--noise", "realsense"), 1, "doughdata generate"),
    "nothing to check": (("validate",), 1, "no such dataset"),
    "nothing to see": (("view", "--save", "x.png"), 1, "no such dataset"),
    "picture": (("view", "--save", "x.jpeg"), 2, ".png"),
    "scenes": (("scenes", "show", "bagel"), 2, "known: "),
    "nothing to compare": (("reproduce", "--scene", "0"), 1, "no such dataset"),
}
BAD |= {  # only where there is none
    f"no {arch}": (("generate", "--scenes", "rolls", "--arch", arch), 2, "no such GPU")
    for arch in ("cuda", "vulkan")
    if not gpu_present(arch)
}


@pytest.mark.parametrize("what", BAD)
def test_bad_usage_gets_one_clear_line(what: str, tmp_path: Path) -> None:
    """A wrong name or a missing thing is told in one line, with its exit code; nothing is made."""
    arguments, code, message = BAD[what]
    done = command(*arguments, cwd=tmp_path, code=code)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("doughdata: ")
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path) -> None:
    """A target that holds other files is refused and not touched."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.txt").write_text("cat")
    done = command("generate", "--scenes", "rolls", "--dataset", "photos", cwd=tmp_path, code=1)
    assert "holds something else" in done.stderr
    assert [p.name for p in (tmp_path / "photos").iterdir()] == ["cat.txt"]


def test_a_scene_outside_its_limits_is_refused(tmp_path: Path) -> None:
    """A scene file with an impossible roll names scene, field, limit and value."""
    scene = {
        "bodies": [{"shape": "roll", "parameters": {"radius": 1.0}}],
        "tools": ["wide"],
        "actions": [{}],
    }
    (tmp_path / "big.json").write_text(json.dumps(scene))
    done = command("generate", "--scenes", "big.json", cwd=tmp_path, code=2)
    assert "scene 'big': roll radius must be within" in done.stderr


def test_dry_run_makes_nothing(tmp_path: Path) -> None:
    """`--dry-run` says what would be made and leaves the folder empty."""
    done = command(
        "generate", "--scenes", "rolls", "--num-scenes", 3, "--dry-run", "--json", cwd=tmp_path
    )
    assert json.loads(done.stdout) == {
        "dataset": "./dough-dataset",
        "scenes": 3,
        "there": 0,
        "left": {"sim": 3, "topology": 3, "mesh": 3},
        "stages": ["simulate", "topology", "mesh"],
    }
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_knows_what_a_stopped_run_left(tmp_path: Path) -> None:
    """A scene that only some layers hold is not done; what was made from a lost layer is lost."""
    uri = write_examples(new_writer(tmp_path / "d"), [cut_ring(), joined_bars()]).uri
    ids = set(open_dataset(uri).scenes["scene_id"].to_pylist())
    made = scenes_made(uri)
    assert made.keys() >= {"sim", "topology", "mesh"}
    assert all(made[layer] == ids for layer in made)
    shutil.rmtree(tmp_path / "d/meta/commits/topology")
    assert scenes_made(uri) == {"sim": ids}


def test_a_shown_scene_runs_as_it_is(tmp_path: Path) -> None:
    """What `scenes show` prints is a scene file that `generate` accepts."""
    shown = command("scenes", "show", "doughnut", "--seed", 3, cwd=tmp_path).stdout
    (tmp_path / "mine.json").write_text(shown)
    assert json.loads(shown)["family"] == "doughnut"
    command("generate", "--scenes", "mine.json", "--dry-run", cwd=tmp_path)
