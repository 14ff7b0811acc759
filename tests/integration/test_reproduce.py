"""A scene is made again and compared with what the dataset holds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from doughcli.rebuild import rebuild_depth, rebuild_stage
from doughdata import open_dataset
from doughdata.reproduce import digest, reproduce
from doughdata.sim.mpm import MpmSimulator
from tests.integration.conftest import command


def test_the_command_finds_every_layer_equal(tiny_dataset: Path) -> None:
    """`reproduce` in a new process finds the same bytes in every layer of a scene."""
    options = ("--scene", 1, "--dataset", tiny_dataset, "--json")
    found = json.loads(command("reproduce", *options, cwd=tiny_dataset.parent).stdout)
    assert set(found["layers"]) == {"sim", "topology", "mesh", "depth.realsense", "depth.none"}
    assert found["equal"]
    assert all(layer["stored"] == layer["again"] for layer in found["layers"].values())


def test_recorded_settings_come_back(tiny_dataset: Path) -> None:
    """A stage built from a commit record has the settings that the record holds."""
    dataset = open_dataset(tiny_dataset)
    for layer in dataset.layers:
        record = dataset.layer(layer, 0).commit.stage
        if layer.startswith("depth."):
            renderer, _ = rebuild_depth(record)
            assert renderer.config.camera.intrinsics.width == 640
            assert renderer.config.frames is None or isinstance(renderer.config.frames, tuple)
        else:
            config = getattr(rebuild_stage(layer, record), "config", None)
            for name in () if config is None else ("frames", "spacing", "reach"):
                assert getattr(config, name, None) == record.config.get(name)


def test_another_setting_is_told(tiny_dataset: Path) -> None:
    """A simulator with another time step is told apart, with the values that differ."""
    dataset = open_dataset(tiny_dataset)
    made = rebuild_stage("sim", dataset.layer("sim", 1).commit.stage)
    other = MpmSimulator(replace(made.config, cfl=0.8 * made.config.cfl))
    (found,) = reproduce(dataset, 1, {"sim": other})
    assert not found.equal
    assert "values of positions differ" in found.difference


def test_one_flipped_bit_changes_the_digest(tiny_dataset: Path) -> None:
    """The digest of a record sees a single bit, a shape and a type."""
    particles = open_dataset(tiny_dataset).read_particles(0)
    flipped = particles.positions.copy()
    flipped.view(np.uint32)[3, 5, 1] ^= 1
    seen = {
        digest(particles),
        digest(replace(particles, positions=flipped)),
        digest(replace(particles, object_ids=particles.object_ids[:-1])),
        digest(replace(particles, spacing=particles.spacing * (1 + 2**-52))),
    }
    assert len(seen) == 4
    assert digest(particles) == digest(replace(particles, positions=particles.positions.copy()))
