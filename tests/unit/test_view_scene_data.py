"""What the views read of a dataset: layers, reasons for missing ones, tools."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.dataset import open_dataset
from doughdata.geometry import transform_points
from doughdata.view.scene_data import finger_poses_at, load_scene, tool_shape
from doughschemas import BadInputError, Tool
from tests.closed_form import cut_ring
from tests.dataset_helpers import equal, new_writer, write_examples


def test_a_scene_is_read_as_it_was_written(tmp_path: Path) -> None:
    """All layers of a full dataset are there, equal to what was written, and nothing is missing."""
    write_examples(new_writer(tmp_path / "d"))
    data, example = load_scene(open_dataset(tmp_path / "d"), 0), cut_ring()
    assert data.missing == {}
    assert data.sensor == "none"
    assert equal(data.particles, example.particles)
    assert equal(data.depth, example.depth)
    assert data.topology is not None
    assert data.topology.events == example.topology.events
    assert data.meshes is not None
    for frame, meshes in enumerate(example.meshes):
        assert equal(data.meshes(frame), meshes.meshes)


@pytest.mark.parametrize(
    ("layers", "missing"),
    [
        (("sim",), {"topology", "mesh", "depth"}),
        (("sim", "topology"), {"mesh", "depth"}),
        (("sim", "topology", "mesh"), {"depth"}),
    ],
)
def test_a_missing_layer_has_a_reason(
    layers: tuple[str, ...], missing: set[str], tmp_path: Path
) -> None:
    """Each missing layer says which command makes it, and not where the dataset lies."""
    write_examples(new_writer(tmp_path / "d"), layers=layers)
    data = load_scene(open_dataset(tmp_path / "d"), 0)
    assert set(data.missing) == missing
    assert data.depth is None
    assert (data.topology is None, data.meshes is None) == (
        "topology" in missing, "mesh" in missing,
    )  # fmt: skip
    for reason in data.missing.values():
        assert "make it with `doughdata" in reason
        assert str(tmp_path) not in reason


def test_a_failed_layer_has_its_failure(tmp_path: Path) -> None:
    """A scene whose mesh failed tells why, while the other scene has its meshes."""
    failed = {"mesh": {0: "no closed surface"}}
    layers = ("sim", "topology", "mesh")
    write_examples(new_writer(tmp_path / "d"), layers=layers, failed=failed)
    dataset = open_dataset(tmp_path / "d")
    assert "no closed surface" in load_scene(dataset, 0).missing["mesh"]
    assert load_scene(dataset, 1).meshes is not None


def test_wrong_names_are_refused(tmp_path: Path) -> None:
    """A scene or sensor that is not there raises and names what is."""
    write_examples(new_writer(tmp_path / "d"))
    dataset = open_dataset(tmp_path / "d")
    with pytest.raises(BadInputError, match=r"no scene 7: the dataset holds 0\.\.1"):
        load_scene(dataset, 7)
    with pytest.raises(BadInputError, match=r"no depth of sensor 'lidar' \(there is: none\)"):
        load_scene(dataset, 0, sensor="lidar")


def test_an_empty_dataset_says_what_to_do(tmp_path: Path) -> None:
    """Without a simulated scene there is nothing to look at."""
    new_writer(tmp_path / "d").refresh()
    with pytest.raises(BadInputError, match="doughdata generate"):
        load_scene(open_dataset(tmp_path / "d"), 0)


def test_a_box_finger_is_a_box() -> None:
    """Its surface is closed and outward, has the box's volume and place, and twelve edges."""
    tool = Tool(name="blade", depth=0.012, width=0.004, height=0.03)
    shape = tool_shape(tool)
    solid = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(0.012 * 0.004 * 0.03, rel=1e-5)
    assert solid.bounds == pytest.approx(np.array([[0, -0.002, 0], [0.012, 0.002, 0.03]]))
    lengths = np.linalg.norm(np.diff(shape.vertices[shape.edges], axis=1)[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx([0.004] * 4 + [0.012] * 4 + [0.03] * 4)


def test_a_mesh_finger_shows_its_creases_alone(tmp_path: Path) -> None:
    """Of a cylinder with 48 sides the two rims are drawn, and none of the smooth side."""
    solid = trimesh.creation.cylinder(radius=0.005, height=0.02, sections=48)
    solid.export(tmp_path / "rod.ply")
    shape = tool_shape(Tool(name="rod", mesh=str(tmp_path / "rod.ply")))
    assert len(shape.edges) == 2 * 48
    ends = shape.vertices[shape.edges][..., 2]
    assert np.abs(ends) == pytest.approx(np.full(ends.shape, 0.01))


def test_poses_carry_fingers_into_the_world(tmp_path: Path) -> None:
    """Rotation and position of every key frame move points as the poses of the dataset do."""
    write_examples(new_writer(tmp_path / "d"))
    data = load_scene(open_dataset(tmp_path / "d"), 0)
    poses, points = finger_poses_at(data), data.tools[0].vertices
    given = data.particles.tool_poses
    for frame in range(data.num_frames):
        for finger, pose in enumerate(poses[frame]):
            there = transform_points(
                points, given.position[frame, finger], given.quaternion[frame, finger]
            )
            assert np.allclose(points @ pose[:, :3].T + pose[:, 3], there)
