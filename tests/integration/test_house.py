"""The wheel holds what it should; the import contracts bite."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(folder),
        str(ROOT),
    ]
    subprocess.run(build, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_exposes_four_packages(wheel: Path) -> None:
    """Nothing but doughdata, doughnet, doughcli, doughschemas and the metadata is installed."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    top = {name.partition("/")[0] for name in names}
    assert {n for n in top if not n.endswith(".dist-info")} == {
        "doughdata",
        "doughnet",
        "doughcli",
        "doughschemas",
    }
    assert "doughschemas/SPEC.md" in names
    assert any(name.endswith("LICENSE") for name in names)


def test_the_wheel_runs_outside_the_clone(wheel: Path, tmp_path: Path) -> None:
    """Unpacked anywhere, with the light dependencies alone, the command answers."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "unpacked")
    code = (
        "import doughdata, sys; assert '/unpacked/' in doughdata.__file__\n"
        "sys.argv = ['doughdata', 'plugins']\n"
        "from doughcli.app import main\nmain()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path / "unpacked"), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
    )
    assert "realsense" in done.stdout, done.stderr


PLANTED = {
    "a stage imports another": ("doughdata/mesh/planted.py", "import doughdata.sim\n"),
    "the contract imports the toolkit": ("schemas/doughschemas/planted.py", "import doughdata\n"),
    "torch outside its homes": ("doughdata/scenes/planted.py", "import torch\n"),
    "taichi outside sim": ("doughdata/render/planted.py", "import taichi\n"),
    "the model reaches the simulator": ("doughnet/planted.py", "import doughdata.sim\n"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", PLANTED)
def test_import_contracts_bite(what: str, tmp_path: Path) -> None:
    """A planted violation breaks a contract; the clean tree keeps them all."""
    for name in ("doughdata", "doughnet", "cli", "schemas", "pyproject.toml"):
        subprocess.run(["cp", "-r", str(ROOT / name), str(tmp_path)], check=True)
    linter = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    path = {
        "PYTHONPATH": f"{tmp_path}:{tmp_path / 'cli'}:{tmp_path / 'schemas'}",
        "PATH": "/usr/bin:/bin",
    }
    clean = subprocess.run(linter, cwd=tmp_path, env=path, capture_output=True, text=True)
    assert clean.returncode == 0, clean.stdout + clean.stderr
    file, text = PLANTED[what]
    (tmp_path / file).write_text(text)
    broken = subprocess.run(linter, cwd=tmp_path, env=path, capture_output=True, text=True)
    assert broken.returncode == 1
    assert "BROKEN" in broken.stdout
