"""`validate --deep`: numbers that are well-formed but cannot be true are found and named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from doughdata.dataset import validate
from doughschemas import FrameTopology, Scene
from tests.closed_form import Example, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

RING, BARS = cut_ring(), joined_bars()
POSES = RING.particles.tool_poses


def messages(path: Path, *examples: Example) -> list[str]:
    """What a deep validation says of these examples."""
    writer = write_examples(new_writer(path), examples)
    return [problem.message for problem in validate(writer.uri, deep=True).problems]


def ring_with(**changes: Any) -> Example:
    """The ring with other particles."""
    return replace(RING, particles=replace(RING.particles, **changes))


@pytest.mark.parametrize(
    ("example", "message"),
    [
        (ring_with(positions=RING.particles.positions * np.float32(1000.0)), "not in metres"),
        (ring_with(positions=RING.particles.positions - np.float32(0.05)), "under the table"),
        (ring_with(spacing=RING.particles.spacing * 1000.0), "not in metres"),
        (ring_with(tool_poses=replace(POSES, opening=POSES.opening + 1e-4)), "not as far apart"),
        (ring_with(tool_poses=replace(POSES, opening=-POSES.opening)), "between 0 and"),
        (ring_with(tool_poses=replace(POSES, action=POSES.action + 1)), "action must be 0..0"),
        (ring_with(tool_poses=replace(POSES, position=POSES.position * 1.01)), "not as far apart"),
    ],
)
def test_numbers_that_cannot_be_true_are_found(
    tmp_path: Path, example: Example, message: str
) -> None:
    """Millimetres, dough under the table, an opening that the fingers belie, a wrong action."""
    found = messages(tmp_path / "d", example)
    assert any(message in text for text in found), found


def with_split(scene: Scene, split: str, **changes: Any) -> Scene:
    """The same squeeze under another name, in a split."""
    return replace(scene, scene_id=f"{scene.scene_id}-{split}", split=split, **changes)


@pytest.mark.parametrize(("shift", "leaks"), [(0.0, True), (1e-9, True), (0.002, False)])
def test_near_duplicates_in_two_splits_are_found(tmp_path: Path, shift: float, leaks: bool) -> None:
    """The same squeeze in train and in test is told, whatever its name; another one is not."""
    action = RING.scene.actions[0]
    moved = (replace(action, opening_end=action.opening_end + shift), *RING.scene.actions[1:])
    train = replace(RING, scene=with_split(RING.scene, "train"))
    test = replace(RING, scene=with_split(RING.scene, "test", actions=moved, seed=9))
    found = [text for text in messages(tmp_path / "d", train, test) if "splits" in text]
    assert bool(found) == leaks, found
    if leaks:
        assert test.scene.scene_id in found[0]
    both = replace(RING, scene=with_split(RING.scene, "train", seed=5))
    assert (
        messages(tmp_path / "same", train, replace(both, scene=replace(both.scene, scene_id="b")))
        == []
    )


def with_handles(frame: FrameTopology, genus: int) -> FrameTopology:
    """The frame's first component with a tree, or one loop, for its graph."""
    size = len(frame.graph.particles)
    edges = [[k, k + 1] for k in range(size - 1)] + [[size - 1, 0]] * genus
    return replace(
        frame,
        genus=(genus, *frame.genus[1:]),
        graph=replace(frame.graph, edges=np.array(edges, np.int32)),
    )


@pytest.mark.parametrize("reason", ["", "a neck near the threshold"])
def test_a_mesh_of_another_genus_than_its_label_is_found(tmp_path: Path, reason: str) -> None:
    """A ring labelled as a ball is a contradiction, unless the check itself was unsure."""
    first = RING.topology.frames[0]
    genus = RING.topology.frames[0].genus[0]
    assert genus == trimesh.Trimesh(*_solid(RING)).euler_number // -2 + 1 == 1
    wrong = replace(with_handles(first, 0), ambiguous_reason=reason)
    topology = replace(RING.topology, frames=(wrong, *RING.topology.frames[1:]))
    found = messages(tmp_path / "d", replace(RING, topology=topology))
    assert [("another genus than their labels in 1 of 3" in text) for text in found] == (
        [] if reason else [True]
    )


def _solid(example: Example) -> tuple[np.ndarray, np.ndarray]:
    mesh = example.meshes[0].meshes[0]
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)


def test_a_flipped_bit_in_a_tool_mesh_is_found(tmp_path: Path) -> None:
    """Meshes of tools are files of the dataset too: their name is their sha256."""
    box = trimesh.creation.box(extents=[10, 20, 40])
    box.apply_translation([5, 0, 20])
    box.export(tmp_path / "tool.stl")
    tool = replace(RING.scene.tools[0], mesh=str(tmp_path / "tool.stl"), scale=0.001)
    example = replace(RING, scene=replace(RING.scene, tools=(tool,)))
    assert messages(tmp_path / "d", example) == []
    (asset,) = (tmp_path / "d/assets/tools").iterdir()
    data = bytearray(asset.read_bytes())
    data[-1] ^= 4
    asset.write_bytes(data)
    (problem,) = validate(tmp_path / "d").problems
    assert problem.file == f"assets/tools/{asset.name}"
