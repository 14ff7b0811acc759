"""The durability benchmark itself, in small: what it counts must be nothing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "durability.py"


@pytest.mark.slow
def test_kills_races_and_flips_cost_nothing() -> None:
    """On a disk and in a bucket: nothing lost, doubled or hidden, whatever was killed or raced."""
    size = ("--kills", "8", "--command-kills", "2", "--flips", "20", "--seed", "1")
    command = [sys.executable, str(BENCHMARK), "--json", *size]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert (found["kills"], found["flips"], found["races"]) == (10, 20, 32)
    for key in ("lost", "doubled", "bad_hashes", "other_fingerprint"):
        assert found[key] == 0, key
    assert (found["races_won_twice"], found["races_orphans"]) == (0, 0)
    assert found["flips_found"] == found["flips_named"] == 20
