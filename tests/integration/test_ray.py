"""Ray: a cluster of two nodes works on one bucket; a node that is lost costs nothing."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from doughdata.dataset import open_dataset
from doughdata.dataset.commits import CommitLog
from doughdata.dataset.store import store_of
from tests.integration.conftest import FRAMES, command
from tests.object_store import BUCKET, environment, object_store, set_environment

HEAD = """
import sys, time
from ray.cluster_utils import Cluster
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
node = cluster.add_node(num_cpus=1)
print(cluster.address, node.node_id, flush=True)
sys.stdin.readline()
cluster.remove_node(node, allow_graceful=False)
print("removed", flush=True)
sys.stdin.readline()
cluster.shutdown()
"""


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    with object_store() as endpoint, set_environment(**environment(endpoint)):
        yield f"s3://{BUCKET}/dough"


@pytest.fixture
def cluster(bucket: str) -> Iterator[subprocess.Popen[str]]:
    """Two nodes of one core each; a line on stdin kills the second, as a power cut would."""
    process = subprocess.Popen(
        [sys.executable, "-c", HEAD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.communicate("\n\n", timeout=60)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def sim_hashes(uri: str | Path) -> dict[str, dict[str, str]]:
    """Shard -> hashes of the files of its `sim` layer."""
    log = CommitLog(store_of(uri))
    return {shard: dict(log.fresh(shard)["sim"].files) for shard in log.shards}


@pytest.mark.slow
def test_a_node_killed_in_mid_run_costs_nothing(
    bucket: str,
    cluster: subprocess.Popen[str],
    tiny_scenes: Path,
    tiny_dataset: Path,
    tmp_path: Path,
) -> None:
    """`generate` and `render` on two nodes into a bucket, one killed: as `serial` made it here."""
    assert cluster.stdin is not None
    assert cluster.stdout is not None
    address = cluster.stdout.readline().split()[0]
    ray = {"RAY_ADDRESS": address}
    scenes = json.loads(tiny_scenes.read_text())
    arguments = ("--scenes", tiny_scenes, "--frames", FRAMES, "--dataset", bucket, "--json")
    with set_environment(**ray):
        run = subprocess.Popen(
            [
                str(Path(sys.executable).with_name("doughdata")),
                *map(str, ("generate", *arguments, "--executor", "ray")),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        store = store_of(bucket)
        while not store.names("meta/commits/sim"):  # the nodes are at work
            assert run.poll() is None, run.communicate()
            time.sleep(0.2)
        print(file=cluster.stdin, flush=True)
        assert cluster.stdout.readline() == "removed\n"
        output, errors = run.communicate(timeout=300)
        assert run.returncode == 0, errors
        assert json.loads(output)["made"] == dict.fromkeys(("sim", "topology", "mesh"), len(scenes))
        options = ("--dataset", bucket, "--executor", "ray")
        command("render", "--noise", "realsense", "--noise", "none", *options, cwd=tmp_path)
    command("validate", "--deep", "--dataset", bucket, cwd=tmp_path)
    assert sim_hashes(bucket) == sim_hashes(tiny_dataset)
    assert open_dataset(bucket).layers == open_dataset(tiny_dataset).layers


def test_a_cluster_that_is_not_there_is_told_in_one_line(tmp_path: Path) -> None:
    """RAY_ADDRESS without a cluster behind it: the address is named, and what to do."""
    with set_environment(RAY_ADDRESS="127.0.0.1:9"):
        done = command("generate", "--scenes", "ball", "--executor", "ray", cwd=tmp_path, code=1)
    (line,) = [text for text in done.stderr.splitlines() if text.startswith("doughdata:")]
    assert "127.0.0.1:9" in line
    assert "ray start" in line
