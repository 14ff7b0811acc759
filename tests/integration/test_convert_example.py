"""The example of recordings runs as it stands."""

import subprocess
import sys
from pathlib import Path

from tests.recordings_made import RADIUS, write_mcap

EXAMPLE = Path(__file__).parents[2] / "examples" / "06_convert_a_recording.py"


def test_convert_a_recording(tmp_path):
    """Example 6 finds both rolls, at their true height."""
    path = write_mcap(tmp_path / "run.mcap")
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), str(path), "dough", "rolls"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert f"2 pieces of dough, up to {2 * RADIUS * 1e3:.0f} mm high" in done.stdout
