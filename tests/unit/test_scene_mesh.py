"""Bodies from mesh files."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.scenes import load_family, shape_of
from doughdata.scenes.mesh import LONGEST, scale_range
from doughdata.scenes.regions import REGIONS
from doughdata.scenes.shapes.mesh import body_mesh, mesh_digest
from doughdata.sim.mpm import MpmConfig, fill_bodies
from doughschemas import Body, SceneError


@pytest.fixture
def torus(tmp_path: Path) -> Path:
    path = tmp_path / "torus.stl"
    trimesh.creation.torus(2.0, 0.7, major_sections=48, minor_sections=24).export(path)
    return path


def grid(low: np.ndarray, high: np.ndarray, h: float) -> np.ndarray:
    axes = [np.arange(a + h / 2, b, h) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def test_inside_is_the_meshs_own_volume(torus: Path) -> None:
    """Counting grid points inside gives trimesh's signed volume within 1 %, at any rotation."""
    half = math.sqrt(0.5)
    for turn in ({}, {"qx": half, "qw": half}, {"qx": 0.5, "qy": 0.5, "qz": 0.5, "qw": 0.5}):
        body = Body(shape="mesh", parameters={"file": str(torus), "scale": 0.010, **turn})
        solid = shape_of(body)
        volume = solid.contains(grid(*solid.bounds(), 0.001)).sum() * 0.001**3
        assert volume == pytest.approx(body_mesh(torus).volume * 0.010**3, rel=0.01)


def test_a_turned_box_is_inside_where_the_closed_form_says(tmp_path: Path) -> None:
    """Points of a box turned by the stated quaternion agree with its six half-spaces."""
    path = tmp_path / "box.stl"
    trimesh.creation.box(extents=[20, 30, 40]).apply_translation([7, -3, 11]).export(path)
    angle = 0.4
    turn = {"qx": math.sin(angle / 2), "qw": math.cos(angle / 2)}
    solid = shape_of(Body(shape="mesh", parameters={"file": str(path), "scale": 0.001, **turn}))
    low, high = solid.bounds()
    c, s = math.cos(angle), math.sin(angle)
    half = [0.010, (0.030 * c + 0.040 * s) / 2, (0.030 * s + 0.040 * c) / 2]
    np.testing.assert_allclose(low, [-half[0], -half[1], 0.0], atol=1e-6)
    np.testing.assert_allclose(high, [half[0], half[1], 2 * half[2]], atol=1e-6)
    points = np.random.default_rng(0).uniform(low - 0.002, high + 0.002, (4000, 3))
    x, y, z = (points - [0, 0, half[2]]).T
    local = np.abs(np.stack([x, c * y + s * z, c * z - s * y])).T - [0.010, 0.015, 0.020]
    clear = np.abs(local.max(axis=1)) > 1e-5
    np.testing.assert_array_equal(solid.contains(points)[clear], (local.max(axis=1) < 0)[clear])


def test_format_and_path_of_a_mesh_do_not_matter(torus: Path, tmp_path: Path) -> None:
    """A text file and its copies in single precision give the same scenes but for the path."""
    paths = [tmp_path / name for name in ("first.obj", "second.glb", "third.stl")]
    trimesh.load(torus, force="mesh").export(paths[0])
    for path in paths[1:]:
        body_mesh(paths[0]).copy().export(path)
    assert len({mesh_digest(path) for path in paths}) == 1
    scenes = [load_family(f"mesh:{path}").sample(seed=1, number=3, split="train") for path in paths]
    assert len({scene.scene_id for scene in scenes}) == 1
    assert len({scene.actions for scene in scenes}) == 1
    for scene in scenes[1:]:
        same = {k: v for k, v in scene.bodies[0].parameters.items() if k != "file"}
        assert same == {k: v for k, v in scenes[0].bodies[0].parameters.items() if k != "file"}


def test_another_mesh_has_other_scene_ids(torus: Path, tmp_path: Path) -> None:
    """Two meshes in one dataset do not collide."""
    trimesh.creation.box(extents=[1, 2, 3]).export(tmp_path / "torus2.stl")
    ids = {
        load_family(f"mesh:{path}").sample(seed=0, number=0, split="train").scene_id
        for path in (torus, tmp_path / "torus2.stl")
    }
    assert len(ids) == 2


def test_mesh_scales_keep_the_regions_apart(torus: Path) -> None:
    """Train and test scenes of a mesh have disjoint scales, within the stated largest size."""
    low, high = scale_range(torus)
    mesh = body_mesh(torus)
    assert high * max(mesh.extents) <= LONGEST * (1 + 1e-9)
    assert high**3 * mesh.volume <= 4 / 3 * math.pi * 0.020**3 * (1 + 1e-9)
    for split in ("train", "test"):
        for number in range(25):
            scene = load_family(f"mesh:{torus}").sample(seed=0, number=number, split=split)
            u = (float(scene.bodies[0].parameters["scale"]) - low) / (high - low)
            assert any(a - 1e-3 <= u <= b + 1e-3 for a, b in REGIONS[scene.region])


def test_particles_fill_the_mesh(torus: Path) -> None:
    """The particles of a sampled mesh stand for its volume within 2 %."""
    scene = load_family(f"mesh:{torus}").sample(seed=0, number=0, split="train")
    config = MpmConfig(spacing=0.002)
    positions, _ = fill_bodies(scene, config, np.random.default_rng(0))
    scale = float(scene.bodies[0].parameters["scale"])
    expected = body_mesh(torus).volume * scale**3
    assert len(positions) * config.spacing**3 == pytest.approx(expected, rel=0.02)


def damaged(tmp_path: Path, how: str) -> Path:
    path, mesh = tmp_path / "bad.stl", trimesh.creation.box(extents=[1, 2, 3])
    if how == "open":
        mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    if how == "two":
        mesh = trimesh.util.concatenate([mesh, mesh.copy().apply_translation([9, 0, 0])])
    mesh.export(path)
    if how == "text":
        path.write_text("solid nothing\nendsolid nothing\n")
    return path


@pytest.mark.parametrize(
    ("how", "words"),
    [("open", "watertight"), ("two", "one closed surface, got 2"), ("text", "bad.stl")],
)
def test_a_mesh_that_is_no_body_is_refused_with_words(tmp_path: Path, how: str, words: str) -> None:
    """Holes, several pieces and files without triangles are named in one line."""
    with pytest.raises(SceneError, match=words) as caught:
        load_family(f"mesh:{damaged(tmp_path, how)}").sample(seed=0, number=0, split="train")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "parameters",
    [{}, {"file": "no.stl"}, {"scale": math.nan}, {"qw": 0.0}, {"qx": math.inf}, {"scale": 10.0}],
)
def test_a_broken_mesh_body_is_refused(torus: Path, parameters: dict) -> None:
    """A missing file, a zero rotation and numbers that are none are scene errors."""
    given = (
        parameters if parameters in ({}, {"file": "no.stl"}) else {"file": str(torus), **parameters}
    )
    with pytest.raises(SceneError, match="mesh"):
        shape_of(Body(shape="mesh", parameters=given)).bounds()
