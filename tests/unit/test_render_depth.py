"""Depth images against closed forms, against brute force, and the seeds of a rendering stage."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.geometry import pixel_rays, points_from_depth, quaternion_to_matrix
from doughdata.render._open3d import system_library_error
from doughdata.render.cameras import default_camera, jittered, look_at
from doughdata.render.depth import DepthRenderer, DepthStage, RenderConfig, quantised
from doughdata.render.sensors.blenderproc import BlenderProc
from doughdata.render.sensors.none import NoNoise
from doughdata.render.sensors.realsense import RealSense
from doughdata.scenes.tools import finger_poses, tool_preset
from doughdata.stages import DepthImage
from doughschemas import (
    SEGMENT_COMPONENT,
    SEGMENT_NONE,
    SEGMENT_TABLE,
    SEGMENT_TOOL,
    Action,
    BadInputError,
    Body,
    Camera,
    ComponentMesh,
    ComponentMeshes,
    Intrinsics,
    LabelGrid,
    MissingPackageError,
    Scene,
    Tool,
    ToolPoses,
)

SMALL = Intrinsics(width=160, height=120, fx=150.0, fy=152.0, cx=80.3, cy=58.9)
EMPTY = ComponentMesh(vertices=np.zeros((0, 3), np.float32), faces=np.zeros((0, 3), np.uint32))


def record(mesh: trimesh.Trimesh) -> ComponentMesh:
    """A trimesh as a record."""
    return ComponentMesh(
        vertices=np.asarray(mesh.vertices, np.float32), faces=np.asarray(mesh.faces, np.uint32)
    )


def ball(radius: float, centre: tuple[float, float, float]) -> trimesh.Trimesh:
    """A fine sphere."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def meshes(*parts: trimesh.Trimesh) -> ComponentMeshes:
    """Components of one key frame, with an empty label grid."""
    grid = LabelGrid(labels=np.full((2, 2, 2), 255, np.uint8), origin=np.zeros(3), spacing=1e-3)
    return ComponentMeshes(meshes=tuple(record(part) for part in parts), label_grid=grid)


def squeeze(frames: int, scene_id: str = "one", yaw: float = 0.4) -> tuple[Scene, ToolPoses]:
    """A scene with one squeeze and its finger poses."""
    action = Action(yaw=yaw, opening_start=0.08, opening_end=0.02)
    scene = Scene(
        scene_id=scene_id,
        family="custom",
        bodies=(Body(shape="ring"),),
        tools=(tool_preset("regular"),),
        actions=(action,),
    )
    opening = np.linspace(0.08, 0.02, frames)
    poses = [finger_poses(action, value) for value in opening]
    return scene, ToolPoses(
        position=np.stack([position for position, _ in poses]),
        quaternion=np.stack([quaternion for _, quaternion in poses]),
        opening=opening,
        action=np.zeros(frames, np.int32),
    )


def one_image(camera: Camera, *parts: trimesh.Trimesh) -> DepthImage:
    """Ideal image of some components on the table."""
    return DepthRenderer().render([record(part) for part in parts], [], [camera])[0]


def test_empty_table_has_the_depth_of_its_plane() -> None:
    """Every pixel that sees the table has the depth of the plane z = 0 within 2 micrometres."""
    camera = default_camera()
    rays = pixel_rays(camera.intrinsics) @ quaternion_to_matrix(np.array(camera.quaternion)).T
    expected = -camera.position[2] / rays[..., 2]
    image = one_image(camera)
    assert (image.segments == SEGMENT_TABLE).all()
    assert np.abs(image.depth - expected).max() < 2e-6


def test_sphere_has_its_closed_form() -> None:
    """Pixels well inside a sphere's outline have its analytic depth within the mesh's own error."""
    centre, radius = np.array([0.01, -0.02, 0.05]), 0.05
    camera = look_at(SMALL, (0.2, 0.1, 0.4), (0.0, 0.0, 0.03))
    mesh = ball(radius, (0.01, -0.02, 0.05))
    image = one_image(camera, mesh)
    rays = pixel_rays(SMALL) @ quaternion_to_matrix(np.array(camera.quaternion)).T
    offset = np.array(camera.position) - centre
    a, b = (rays**2).sum(-1), rays @ offset
    inside = b**2 - a * (offset @ offset - radius**2)
    expected = (-b - np.sqrt(np.maximum(inside, 0))) / a
    # The ray's angle to the surface: a facet's error along the ray is its depth over this cosine.
    cosine = np.sqrt(np.maximum(inside, 0)) / (radius * np.sqrt(a))
    clear = cosine > 0.5
    planes = np.einsum("fi,fi->f", mesh.face_normals, mesh.triangles_center - centre)
    facet = radius - planes.min()
    assert clear.sum() > 500
    assert (image.segments[clear] == SEGMENT_COMPONENT).all()
    assert np.abs(image.depth - expected)[clear].max() < facet / 0.5 + 2e-6


def first_hit(origin: np.ndarray, rays: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance in units of each ray to the first triangle, by trying all (Moeller-Trumbore)."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(rays[:, None], (c - a)[None])
    determinant = np.einsum("rtx,tx->rt", normal, b - a)
    determinant = np.where(np.abs(determinant) < 1e-15, np.nan, determinant)
    u = np.einsum("rtx,tx->rt", normal, origin - a) / determinant
    turned = np.cross(origin - a, b - a)
    v = rays @ turned.T / determinant
    distance = np.einsum("tx,tx->t", c - a, turned)[None] / determinant
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    return np.where(hit, distance, np.inf).min(axis=1)


def test_depth_agrees_with_brute_force() -> None:
    """On random pixels, trying every triangle in float64 finds the same depth and component."""
    ring = trimesh.creation.torus(0.025, 0.008, major_sections=48, minor_sections=24)
    ring.apply_translation([0, 0, 0.008])
    cube = trimesh.creation.box(extents=[0.02, 0.02, 0.02])
    cube.apply_translation([0.05, 0.02, 0.01])
    camera = look_at(SMALL, (0.05, 0.25, 0.25))
    image = one_image(camera, ring, cube)
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(40, 80, 500), rng.integers(50, 110, 500)
    rays = pixel_rays(SMALL)[rows, columns] @ quaternion_to_matrix(np.array(camera.quaternion)).T
    origin = np.array(camera.position)
    candidates = np.stack(
        [
            -origin[2] / rays[:, 2],
            *(first_hit(origin, rays, part.triangles) for part in (ring, cube)),
        ]
    )
    segments = np.array([SEGMENT_TABLE, SEGMENT_COMPONENT, SEGMENT_COMPONENT + 1])
    nearest = segments[candidates.argmin(axis=0)]
    same = nearest == image.segments[rows, columns]
    assert same.mean() > 0.99  # a ray may graze an edge
    assert set(nearest) == set(segments)
    assert np.abs(candidates.min(axis=0) - image.depth[rows, columns])[same].max() < 5e-6


def test_segments_name_table_tool_components_and_nothing() -> None:
    """A camera at the horizon sees all five kinds; an empty mesh keeps the others' numbers."""
    camera = look_at(SMALL, (0.0, 0.4, 0.05), (0.0, 0.0, 0.05))
    parts = [record(ball(0.02, (-0.05, 0, 0.02))), EMPTY, record(ball(0.02, (0.05, 0, 0.02)))]
    finger = trimesh.creation.box(extents=[0.01, 0.01, 0.05])
    finger.apply_translation([0.0, 0.0, 0.05])
    image = DepthRenderer().render(parts, [record(finger)], [camera])[0]
    expected = {
        SEGMENT_NONE, SEGMENT_TABLE, SEGMENT_TOOL, SEGMENT_COMPONENT, SEGMENT_COMPONENT + 2,
    }  # fmt: skip
    assert set(np.unique(image.segments)) == expected
    assert ((image.depth == 0) == (image.segments == SEGMENT_NONE)).all()


def test_cameras_cast_together_see_what_each_sees_alone() -> None:
    """Images of three cameras of different sizes are bitwise those of one camera at a time."""
    tiny = Intrinsics(width=40, height=30, fx=35.0, fy=35.0, cx=20.0, cy=15.0)
    cameras = [look_at(SMALL, (0.2, 0.2, 0.3)), default_camera(), look_at(tiny, (0.0, -0.3, 0.2))]
    parts = [record(ball(0.02, (0, 0, 0.02)))]
    for camera, together in zip(cameras, DepthRenderer().render(parts, [], cameras), strict=True):
        alone = DepthRenderer().render(parts, [], [camera])[0]
        assert np.array_equal(together.depth, alone.depth)
        assert np.array_equal(together.segments, alone.segments)


def test_stored_depth_is_within_half_a_unit() -> None:
    """Quantised depth is off by at most half a unit; what does not fit becomes invalid."""
    depth = np.random.default_rng(0).uniform(0.1, 6.5, (20, 30)).astype(np.float32)
    assert np.abs(quantised(depth, 1e-4) * 1e-4 - depth).max() <= 0.5e-4 + 1e-6
    odd = np.array([[0.0, np.nan, np.inf, -1.0, 7.0, 2e-5]], np.float32)
    assert (quantised(odd, 1e-4) == 0).all()


def test_fingers_stand_at_the_opening() -> None:
    """Tool pixels, back-projected, lie between the contact faces and the backs of the fingers."""
    scene, poses = squeeze(6)
    stage = DepthStage(RenderConfig(frames=(5,)))
    dough = {5: meshes(ball(0.008, (0, 0, 0.008)))}
    views = stage.views(scene, poses, dough, sensors={"none": NoNoise()})["none"]
    depth = views.depth[0].astype(np.float64) * views.depth_unit
    points = points_from_depth(depth, views.cameras[0], views.segments[0] == SEGMENT_TOOL)
    axis = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    distance = np.abs(points @ axis)
    half = poses.opening[5] / 2
    assert len(points) > 200
    assert distance.min() > half - 2e-4  # depth is stored in steps of 0.1 mm
    assert distance.max() < half + 0.010 + 2e-4
    assert (np.sign(points @ axis) > 0).any()
    assert (np.sign(points @ axis) < 0).any()


def test_tool_from_a_file_looks_like_the_same_box(tmp_path: Path) -> None:
    """A box finger loaded from a mesh file in millimetres gives the image of the built-in box."""
    scene, poses = squeeze(1)
    box = trimesh.creation.box(extents=[10, 10, 50])
    box.apply_translation([5, 0, 25])
    box.export(tmp_path / "finger.stl")
    own = Tool(name="own", mesh=str(tmp_path / "finger.stl"), scale=1e-3)
    stage, dough = DepthStage(RenderConfig(frames=None)), {0: meshes(ball(0.01, (0, 0, 0.01)))}
    first, second = (
        stage.views(each, poses, dough, sensors={"none": NoNoise()})["none"]
        for each in (scene, replace(scene, tools=(own,)))
    )
    assert (first.segments == SEGMENT_TOOL).sum() > 200
    assert (first.segments != second.segments).mean() < 1e-4
    assert np.median(np.abs(first.depth.astype(int) - second.depth)) == 0


def test_each_action_brings_its_own_tool() -> None:
    """In a frame the fingers are those of the action of that frame, not of the first one."""
    scene, poses = squeeze(2)
    wide = (tool_preset("regular"), tool_preset("wide"))
    actions = (scene.actions[0], replace(scene.actions[0], tool=1))
    scene = replace(scene, tools=wide, actions=actions)
    poses = replace(poses, action=np.array([0, 1], np.int32))
    stage = DepthStage(RenderConfig(frames=None))
    dough = dict.fromkeys(range(2), meshes(ball(0.01, (0, 0, 0.01))))
    seen = stage.views(scene, poses, dough, sensors={"none": NoNoise()})["none"].segments
    regular, vise = (seen == SEGMENT_TOOL).sum(axis=(1, 2))
    assert vise > 2 * regular > 0


def test_rows_are_frame_major_and_views_keep_their_camera() -> None:
    """Rows run over frames, then views; a view has one camera, and views differ."""
    scene, poses = squeeze(8)
    config = RenderConfig(camera=look_at(SMALL, (0.1, 0.3, 0.3)), views=2, frames=(5, 1, 5))
    dough = {frame: meshes(ball(0.01, (0, 0, 0.01))) for frame in (1, 5)}
    views = DepthStage(config).views(scene, poses, dough, sensors={"none": NoNoise()})["none"]
    assert views.frame_index.tolist() == [1, 1, 5, 5]
    assert views.view_index.tolist() == [0, 1, 0, 1]
    assert views.cameras[0] == views.cameras[2]
    assert views.cameras[0] != views.cameras[1]
    assert views.depth.shape == views.segments.shape == (4, 120, 160)


def test_noise_depends_on_scene_sensor_frame_and_view_alone() -> None:
    """Other sensors and frames beside it change nothing; another scene, frame or view does."""
    camera = look_at(SMALL, (0.1, 0.3, 0.3))
    dough = {frame: meshes(ball(0.01, (0, 0, 0.01))) for frame in range(4)}
    all_frames = DepthStage(RenderConfig(camera=camera, frames=None, views=2))
    one_frame = DepthStage(RenderConfig(camera=camera, frames=(2,), views=2))
    scene, poses = squeeze(4)
    sensors = {"none": NoNoise(), "realsense": RealSense(), "blenderproc": BlenderProc()}
    many = all_frames.views(scene, poses, dough, sensors=sensors)
    alone = one_frame.views(scene, poses, dough, sensors={"realsense": RealSense()})
    assert np.array_equal(many["realsense"].depth[4:6], alone["realsense"].depth)
    assert many["realsense"].cameras[4:6] == alone["realsense"].cameras
    other = one_frame.views(*squeeze(4, "two"), dough, sensors={"realsense": RealSense()})
    assert other["realsense"].cameras != alone["realsense"].cameras
    # Where two frames of one view see the same, their noise still differs.
    ideal, noisy = many["none"].depth, many["blenderproc"].depth
    still = (ideal[0] == ideal[2]) & (noisy[0] > 0) & (noisy[2] > 0)
    assert still.mean() > 0.5
    assert (noisy[0] == noisy[2])[still].mean() < 0.2
    error = noisy.astype(int) - ideal
    assert (error[0] == error[1]).mean() < 0.2


class HalfSize:
    """A faulty plug-in: it returns every second pixel."""

    def observe(self, image: DepthImage, camera: Camera, *, rng: np.random.Generator) -> np.ndarray:
        """Depth of the wrong shape."""
        del camera, rng
        return image.depth[::2, ::2]


class Scribbler:
    """A faulty plug-in: it writes into the image that all sensors share."""

    def observe(self, image: DepthImage, camera: Camera, *, rng: np.random.Generator) -> np.ndarray:
        """Depth, after spoiling the ideal one."""
        del camera, rng
        image.depth[:] = 0
        return image.depth


def test_faulty_sensors_are_found_out() -> None:
    """A sensor that returns another shape is named, one that spoils the shared image fails."""
    scene, poses = squeeze(1)
    stage = DepthStage(RenderConfig(camera=look_at(SMALL, (0.1, 0.3, 0.3)), frames=None))
    dough = {0: meshes(ball(0.01, (0, 0, 0.01)))}
    with pytest.raises(BadInputError, match=r"'half' must return floats of shape \(120, 160\)"):
        stage.views(scene, poses, dough, sensors={"half": HalfSize()})
    with pytest.raises(ValueError, match="read-only"):
        stage.views(scene, poses, dough, sensors={"scribbler": Scribbler()})


def test_default_frames_are_the_thirteen_training_frames() -> None:
    """A scene of 75 key frames is rendered at 5, 10, ..., 65, or at all, as configured."""
    assert DepthStage().frame_indices(75) == tuple(range(5, 66, 5))
    assert DepthStage(RenderConfig(frames=None)).frame_indices(75) == tuple(range(75))
    assert DepthStage().frame_indices(20) == (5, 10, 15)


def test_frames_that_do_not_exist_are_named() -> None:
    """A scene too short for every configured frame, and a frame without mesh, raise one line."""
    with pytest.raises(BadInputError, match=r"0\.\.3.*--all-frames"):
        DepthStage().frame_indices(4)
    scene, poses = squeeze(8)
    with pytest.raises(BadInputError, match="key frame 5 has no mesh"):
        DepthStage().views(scene, poses, {}, sensors={"none": NoNoise()})
    with pytest.raises(BadInputError, match="at least one view"):
        DepthStage(RenderConfig(views=0))


def test_jittered_default_camera_keeps_the_dough_in_view() -> None:
    """Over 200 draws of the default jitter the middle of the workspace stays in the picture."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        camera = jittered(default_camera(), rng)
        inside = quaternion_to_matrix(np.array(camera.quaternion)).T @ (-np.array(camera.position))
        u = inside[0] / inside[2] * camera.intrinsics.fx + camera.intrinsics.cx
        v = inside[1] / inside[2] * camera.intrinsics.fy + camera.intrinsics.cy
        assert 60 < u < camera.intrinsics.width - 60
        assert 60 < v < camera.intrinsics.height - 60


def test_missing_system_library_names_the_line_to_type() -> None:
    """The loader's complaint about libusb becomes one line with the package to install."""
    complaint = "libusb-1.0.so.0: cannot open shared object file: No such file or directory"
    error = system_library_error(ImportError(complaint))
    assert isinstance(error, MissingPackageError)  # so that a run stops instead of failing scenes
    assert "apt-get install -y libusb-1.0-0" in str(error)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)  # it comes from worker processes
    assert "libfoo.so.3" in str(system_library_error(ImportError("libfoo.so.3: cannot open")))
