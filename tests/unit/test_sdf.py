"""The signed distance of fingers, judged by closed forms and by trimesh."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.scenes import PRESETS
from doughdata.scenes.sdf import MARGIN, finger_sdf
from doughschemas import SceneError, Tool


def box_distance(tool: Tool, points: np.ndarray) -> np.ndarray:
    """Distance to an axis-aligned box by its nearest point, or its nearest face inside."""
    low = np.array([0.0, -tool.width / 2, 0.0])
    high = np.array([tool.depth, tool.width / 2, tool.height])
    nearest = np.clip(points, low, high)
    outside = np.linalg.norm(points - nearest, axis=1)
    return np.where(outside > 0, outside, -np.minimum(points - low, high - points).min(axis=1))


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_box_fingers_match_the_closed_form(name: str) -> None:
    """Trilinear distance of a box finger is within half a grid cell of the exact one, and of the
    same sign beyond that, anywhere within 10 mm.
    """
    tool = PRESETS[name]
    grid = finger_sdf(tool)
    rng = np.random.default_rng(0)
    low = np.array([-MARGIN, -tool.width / 2 - MARGIN, -MARGIN])
    high = np.array([tool.depth + MARGIN, tool.width / 2 + MARGIN, tool.height + MARGIN])
    points = rng.uniform(low, high, (20_000, 3))
    exact = box_distance(tool, points)
    assert np.abs(grid.sample(points) - exact).max() < 0.5 * grid.spacing
    assert grid.spacing <= 0.0005


def test_the_contact_face_is_exact() -> None:
    """In front of the face, away from its edges, the distance is the closed form to 1e-8 m."""
    grid = finger_sdf(PRESETS["regular"])
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.009, -0.003, 0.003], [0.0019, 0.003, 0.045], (5_000, 3))
    assert np.abs(grid.sample(points) + points[:, 0]).max() < 1e-8


def test_beyond_the_grid_the_distance_is_an_upper_bound() -> None:
    """Outside the grid the answer is never below the true distance and at most 3 times it."""
    tool = PRESETS["regular"]
    points = np.random.default_rng(2).uniform(-0.2, 0.2, (5_000, 3))
    exact, got = box_distance(tool, points), finger_sdf(tool).sample(points)
    far = exact > 2 * MARGIN
    assert far.any()
    assert (got[far] >= exact[far] - 1e-6).all()
    assert (got[far] <= 3 * exact[far]).all()


@pytest.fixture
def capsule_tool(tmp_path: Path) -> Tool:
    """A round finger stored in millimetres."""
    mesh = trimesh.creation.capsule(height=40.0, radius=5.0, count=[32, 32])
    mesh.apply_translation([5.0, 0.0, 25.0])
    mesh.export(tmp_path / "capsule.stl")
    return Tool(name="capsule", mesh=str(tmp_path / "capsule.stl"), scale=0.001)


def test_mesh_fingers_match_the_closed_form(capsule_tool: Tool) -> None:
    """A capsule's distance is that of its axis minus its radius, up to the mesh's own facets."""
    grid = finger_sdf(capsule_tool)
    points = np.random.default_rng(3).uniform(
        [-0.009, -0.014, -0.009], [0.019, 0.014, 0.059], (5_000, 3)
    )
    axis = np.stack([np.full(len(points), 0.005), np.zeros(len(points)), points[:, 2]], axis=1)
    axis[:, 2] = np.clip(axis[:, 2], 0.005, 0.045)
    exact = np.linalg.norm(points - axis, axis=1) - 0.005
    facet = 0.005 * (1 - np.cos(np.pi / 32)) * 2
    assert np.abs(grid.sample(points) - exact).max() < facet + 0.5 * grid.spacing


def test_a_box_mesh_equals_the_box(tmp_path: Path) -> None:
    """A box read from a mesh file has the distance of the box made of numbers."""
    tool = PRESETS["narrow"]
    box = trimesh.creation.box(extents=[tool.depth, tool.width, tool.height])
    box.apply_translation([tool.depth / 2, 0, tool.height / 2])
    box.export(tmp_path / "box.obj")
    grid = finger_sdf(Tool(name="mesh", mesh=str(tmp_path / "box.obj")))
    points = np.random.default_rng(4).uniform([-0.01, -0.01, -0.01], [0.03, 0.01, 0.06], (5_000, 3))
    assert np.abs(grid.sample(points) - finger_sdf(tool).sample(points)).max() < 1e-6


def test_a_changed_file_is_measured_again(tmp_path: Path) -> None:
    """The cache is keyed by content: a new mesh under an old path gives the new distance."""
    path = tmp_path / "finger.stl"
    values = []
    for size in (0.010, 0.020):
        box = trimesh.creation.box(extents=[size, size, size])
        box.apply_translation([size / 2, 0, size / 2])
        box.export(path)
        grid = finger_sdf(Tool(name="grows", mesh=str(path)))
        values.append(grid.sample(np.array([[size / 2, 0.0, size / 2]]))[0])
    assert values == pytest.approx([-0.005, -0.010], abs=5e-4)


def test_a_missing_mesh_is_refused_by_name() -> None:
    """A mesh file that does not exist is one clear error."""
    with pytest.raises(SceneError, match=r"nowhere\.stl.*not found"):
        finger_sdf(Tool(name="lost", mesh="nowhere.stl"))


@pytest.mark.parametrize("suffix", ["obj", "stl", "glb"])
def test_every_format_gives_the_same_distance(tmp_path: Path, suffix: str) -> None:
    """One finger in millimetres has the distance of the box it is, from OBJ, STL and GLB."""
    path = tmp_path / f"finger.{suffix}"
    box = trimesh.creation.box(extents=[20.0, 3.0, 50.0])
    box.apply_translation([10.0, 0.0, 25.0])
    box.export(path)
    grid = finger_sdf(Tool(name="mm", mesh=str(path), scale=0.001))
    points = np.random.default_rng(5).uniform([-0.01, -0.01, -0.01], [0.03, 0.01, 0.06], (5_000, 3))
    assert np.abs(grid.sample(points) - finger_sdf(PRESETS["narrow"]).sample(points)).max() < 1e-6


@pytest.mark.parametrize("faces", ["all", "some"])
def test_inverted_normals_change_nothing(tmp_path: Path, capsule_tool: Tool, faces: str) -> None:
    """Inside stays negative when every face, or every third one, is wound the wrong way round."""
    mesh = trimesh.load(capsule_tool.mesh, force="mesh")
    turned = mesh.faces.copy()
    chosen = slice(None) if faces == "all" else slice(None, None, 3)
    turned[chosen] = turned[chosen, ::-1]
    path = tmp_path / "turned.obj"
    trimesh.Trimesh(mesh.vertices, turned, process=False).export(path)
    other = finger_sdf(replace(capsule_tool, mesh=str(path)))
    assert np.abs(other.values - finger_sdf(capsule_tool).values).max() < 1e-6


def test_a_file_in_millimetres_is_refused_with_the_scale(tmp_path: Path) -> None:
    """A finger tens of metres long is one clear line that names the scale to set."""
    path = tmp_path / "finger.stl"
    trimesh.creation.box(extents=[10, 10, 50]).export(path)
    with pytest.raises(SceneError, match=r"finger\.stl.*at most 0\.5 m.*50 m.*scale 0\.001"):
        finger_sdf(Tool(name="mm", mesh=str(path)))


def test_an_open_mesh_is_refused(tmp_path: Path) -> None:
    """A finger with a hole has no inside: one clear line."""
    path = tmp_path / "open.stl"
    box = trimesh.creation.box(extents=[0.01, 0.01, 0.05])
    box.update_faces(np.arange(len(box.faces)) > 0)
    box.export(path)
    with pytest.raises(SceneError, match=r"open\.stl.*watertight"):
        finger_sdf(Tool(name="open", mesh=str(path)))
