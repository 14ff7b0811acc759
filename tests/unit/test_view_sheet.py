"""The contact sheet of a small dataset, from no layers to all, and its errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from doughdata.dataset import open_dataset
from doughdata.dataset.commits import StageRecord
from doughdata.dataset.info import DatasetSettings
from doughdata.dataset.writer import DatasetWriter, open_writer
from doughdata.render.depth import DepthStage, RenderConfig
from doughdata.render.sensors.realsense import RealSense
from doughdata.scenes.tools import finger_poses, tool_preset
from doughdata.view.layout import SceneStrip, draw_sheet
from doughdata.view.panels import COLOURS, INVALID, Picture, depth_crop
from doughdata.view.sheet import save_sheet
from doughschemas import (
    STRAY,
    Action,
    BadInputError,
    Body,
    ComponentMesh,
    ComponentMeshes,
    FrameTopology,
    LabelGrid,
    Particles,
    Scene,
    SceneGraph,
    ToolPoses,
    Topology,
    TopologyEvent,
)

FRAMES, CUT = 6, 4  # key frames, and the one in which the ring falls apart
RING, TUBE = 0.0225, 0.0075  # [m]
STAGE = StageRecord(name="by-hand", version="1", config={})


def png_size(path: Path) -> tuple[int, int]:
    """Width and height [px] that a PNG file declares."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(head[16:20]), int.from_bytes(head[20:24])


def ring_particles() -> Particles:
    """A lattice ring that lies still while a blade closes."""
    axis = np.arange(-0.032, 0.033, 0.002)
    grid = np.stack(np.meshgrid(axis, axis, np.arange(0.001, 0.015, 0.002), indexing="ij"), -1)
    points = grid.reshape(-1, 3)
    tube = np.hypot(np.hypot(points[:, 0], points[:, 1]) - RING, points[:, 2] - TUBE)
    points = points[tube < TUBE].astype(np.float32)
    opening = np.linspace(0.1, 0.005, FRAMES)
    poses = [finger_poses(Action(), float(value)) for value in opening]
    return Particles(
        positions=np.repeat(points[None], FRAMES, axis=0),
        object_ids=np.zeros(len(points), np.uint8),
        timestamps=np.linspace(0.0, 1.9, FRAMES),
        tool_poses=ToolPoses(
            position=np.stack([position for position, _ in poses]),
            quaternion=np.stack([quaternion for _, quaternion in poses]),
            opening=opening,
            action=np.zeros(FRAMES, np.int32),
        ),
        spacing=0.002,
    )


def ring_topology(particles: Particles) -> Topology:
    """One ring until `CUT`, two halves and a crumb from there on; the last frame is ambiguous."""
    half = (particles.positions[0, :, 1] > 0).astype(np.uint8)
    angle = np.arange(8) / 8 * 2 * np.pi + 0.2
    nodes = np.stack([RING * np.cos(angle), RING * np.sin(angle), np.full(8, TUBE)], axis=1)
    pairs = [(i, (i + 1) % 8) for i in range(8)]

    def frame(number: int) -> FrameTopology:
        cut = number >= CUT
        labels = half.copy() if cut else np.zeros_like(half)
        labels[0] = STRAY if cut else 0
        sides = (np.sin(angle) > 0).astype(np.uint8) * cut
        edges = [pair for pair in pairs if sides[pair[0]] == sides[pair[1]]]
        return FrameTopology(
            labels=labels,
            genus=(0, 0) if cut else (1,),
            graph=SceneGraph(
                positions=nodes.astype(np.float32),
                components=sides.astype(np.uint8),
                particles=np.full(8, len(half) // 8, np.int32),
                edges=np.array(edges, np.int32),
            ),
            contacts=np.zeros((0, 2), np.int32),
            ambiguous_reason="neck near its threshold" if number == FRAMES - 1 else "",
        )

    none = np.zeros((0, 2), np.int32)
    event = TopologyEvent(
        frame=CUT, kind="split", components_before=(0,), components_after=(0, 1), margin=0.3
    )
    return Topology(
        frames=tuple(frame(number) for number in range(FRAMES)),
        events=(event,),
        static_num_components=np.ones(FRAMES, np.int32),
        static_genus=((1,),) * FRAMES,
        bonds_made=(none,) * FRAMES,
        bonds_broken=(none,) * FRAMES,
    )


def ring_meshes() -> ComponentMeshes:
    """A torus."""
    torus = trimesh.creation.torus(RING, TUBE, major_sections=48, minor_sections=24)
    torus.apply_translation([0, 0, TUBE])
    mesh = ComponentMesh(
        vertices=np.asarray(torus.vertices, np.float32), faces=np.asarray(torus.faces, np.uint32)
    )
    grid = LabelGrid(labels=np.full((2, 2, 2), 255, np.uint8), origin=np.zeros(3), spacing=1e-3)
    return ComponentMeshes(meshes=(mesh,), label_grid=grid)


def scene(number: int) -> Scene:
    """A ring and a narrow blade."""
    return Scene(
        scene_id=f"ring-{number}",
        family="custom",
        bodies=(Body(shape="ring", parameters={"ring_radius": RING, "tube_radius": TUBE}),),
        tools=(tool_preset("narrow"),),
        actions=(Action(),),
    )


def write(writer: DatasetWriter, layer: str, record: object) -> None:
    """Commit one layer of every shard."""
    for task in writer.tasks(layer):
        writer.write(task, dict.fromkeys(task.scenes, record), stage=STAGE)


@pytest.fixture
def writer(tmp_path: Path) -> DatasetWriter:
    """A dataset with particles of two scenes and nothing else."""
    writer = open_writer(str(tmp_path / "dataset"), DatasetSettings(num_frames=FRAMES))
    writer.plan_scenes([scene(0), scene(1)])
    write(writer, "sim", ring_particles())
    return writer


def test_sheet_grows_with_the_layers(writer: DatasetWriter, tmp_path: Path) -> None:
    """Each layer that is made adds its row; the file is a PNG of the size that follows."""
    particles = ring_particles()
    depth = DepthStage(RenderConfig(frames=None)).views(
        scene(0),
        particles.tool_poses,
        dict.fromkeys(range(FRAMES), ring_meshes()),
        sensors={"realsense": RealSense()},
    )["realsense"]
    heights = []
    for layer, record in (
        (None, None),
        ("topology", ring_topology(particles)),
        ("mesh", (ring_meshes(),) * FRAMES),
        ("depth.realsense", depth),
    ):
        if layer is not None:
            write(writer, layer, record)
        path = tmp_path / "sub" / "sheet.png"
        assert save_sheet(open_dataset(writer.uri), path, frames=[0, 5]) == path
        heights.append(png_size(path)[1])
    steps = np.diff(heights)
    assert np.abs(steps - 2 * 1.65 * 150).max() <= 1  # two scenes, 1.65 inch a row, 150 dpi


def test_sheet_shows_what_was_asked_for(writer: DatasetWriter, tmp_path: Path) -> None:
    """Chosen scenes and frames decide the size: a block a scene, a column a frame."""
    dataset = open_dataset(writer.uri)
    one = png_size(save_sheet(dataset, tmp_path / "one.png", scenes=[1], frames=[0, 3]))
    both = png_size(save_sheet(dataset, tmp_path / "both.png", scenes=[1, 0], frames=[0, 3, 5]))
    assert abs((both[0] - one[0]) - 2.2 * 150) <= 1
    assert both[1] > 1.5 * one[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenes": [7]}, r"no scene 7: the dataset holds 0\.\.1"),
        ({"frames": [6]}, r"no key frame 6, but 0\.\.5"),
        ({"sensor": "kinect"}, "doughdata render --noise kinect"),
        ({"scenes": []}, "nothing to draw"),
        ({"frames": []}, "nothing to draw"),
    ],
)
def test_sheet_says_what_is_not_there(
    writer: DatasetWriter, tmp_path: Path, options: dict, message: str
) -> None:
    """A scene, frame or sensor that does not exist raises one line, and no file is left."""
    with pytest.raises(BadInputError, match=message) as caught:
        save_sheet(open_dataset(writer.uri), tmp_path / "sheet.png", **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "sheet.png").exists()


def test_sheet_is_a_png_of_some_scene(tmp_path: Path) -> None:
    """Another suffix and an empty dataset raise one line."""
    writer = open_writer(str(tmp_path / "empty"), DatasetSettings(num_frames=FRAMES))
    dataset = open_dataset(writer.uri)
    with pytest.raises(BadInputError, match=r"saved as \.png, got 'sheet.jpg'"):
        save_sheet(dataset, tmp_path / "sheet.jpg")
    with pytest.raises(BadInputError, match="doughdata generate"):
        save_sheet(dataset, tmp_path / "sheet.png")


def strip(**changes: object) -> SceneStrip:
    """A strip of two frames, before and after the cut."""
    particles = ring_particles()
    topology = ring_topology(particles)
    shape = (60, 80)
    segments = np.ones(shape, np.uint8)
    segments[20:30, 30:50] = 16
    depth = np.full(shape, 0.5, np.float32)
    depth[22:24, 30:40] = 0
    pictures = tuple(
        Picture(
            positions=particles.positions[frame],
            topology=topology.frames[frame],
            meshes=ring_meshes().meshes,
            depth=depth,
            segments=segments,
        )
        for frame in (0, FRAMES - 1)
    )
    base = SceneStrip(
        title="ring", frames=(0, FRAMES - 1), times=(0.0, 1.9), pictures=pictures,
        events=topology.events, sensor="realsense",
    )  # fmt: skip
    return replace(base, **changes)  # type: ignore[arg-type]


def test_heads_tell_topology_events_and_doubts() -> None:
    """Over the columns stand c and g, in them the event since the last column and the doubt."""
    figure = draw_sheet([strip()])
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "c = 1   g = 1" in texts
    assert "c = 2   g = 0,0" in texts
    assert texts.count("split @ 4") == 1
    assert "ambiguous: neck near its threshold" in texts
    titles = [text.get_text() for text in figure.texts]
    assert {"ring", "particles", "mesh", "scene graph", "depth\n(realsense)"} <= set(titles)


def test_events_of_a_kind_share_a_line() -> None:
    """Several events of one kind between two columns stand on one line with their number."""
    split = ring_topology(ring_particles()).events[0]
    events = (replace(split, frame=2), split, replace(split, frame=3, kind="self_merge"))
    figure = draw_sheet([strip(events=events)])
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "split @ 2\N{EN DASH}4 (2)" in texts
    assert "self-merge @ 3" in texts


def test_panels_use_the_component_colours() -> None:
    """Particles have the colours of their components, crumbs grey; the graph has the same."""
    figure = draw_sheet([strip()])
    particles, graph = figure.axes[1], figure.axes[7]
    shown = np.concatenate([c.get_facecolors()[:, :3] for c in particles.collections])
    hues = {int(np.abs(COLOURS / COLOURS.max(1, keepdims=True) - rgb / rgb.max()).sum(1).argmin())
            for rgb in shown if np.ptp(rgb) > 0.2}  # fmt: skip
    assert hues == {0, 1}
    assert (np.ptp(shown, axis=1) < 1e-6).any()
    nodes = graph.collections[-1].get_facecolors()[:, :3]
    assert {tuple(rgb) for rgb in nodes} == {tuple(COLOURS[0]), tuple(COLOURS[1])}
    assert len(graph.lines) == 6  # eight edges of the ring less the two that were cut


def test_invalid_depth_is_marked() -> None:
    """Exactly the invalid pixels have the colour of invalid depth."""
    from matplotlib.colors import to_rgb

    figure = draw_sheet([strip()])
    image = np.asarray(figure.axes[4].images[0].get_array())[..., :3]
    crop = depth_crop(strip().pictures)
    assert strip().pictures[0].depth is not None
    invalid = strip().pictures[0].depth[crop] == 0  # type: ignore[index]
    assert np.array_equal(np.isclose(image, to_rgb(INVALID)).all(axis=-1), invalid)
    assert invalid.sum() == 20


def test_crop_holds_the_dough() -> None:
    """The crop contains all dough, has the shape 4 : 3 and stays inside the image."""
    rows, columns = depth_crop(strip().pictures)
    assert rows.start <= 20
    assert rows.stop >= 30
    assert columns.start <= 30
    assert columns.stop >= 50
    assert abs((columns.stop - columns.start) / (rows.stop - rows.start) - 4 / 3) < 0.1
    empty = replace(strip().pictures[0], segments=np.ones((60, 80), np.uint8))
    assert depth_crop([empty]) == (slice(0, 60), slice(0, 80))


def test_sheet_without_scenes_is_refused() -> None:
    """No strip, or a strip without a picture, raises."""
    for strips in ([], [strip(frames=(), times=(), pictures=())]):
        with pytest.raises(BadInputError, match="nothing to draw"):
            draw_sheet(strips)
