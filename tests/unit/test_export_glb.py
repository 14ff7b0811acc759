"""A written .glb against the dataset it came from, read back by trimesh and by pygltflib."""

from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh

from doughcli.export import command
from doughdata import open_dataset
from doughdata.dataset import Dataset
from doughdata.exporters.glb import Glb
from doughdata.exporters.protocol import Exporter
from doughdata.geometry import transform_points
from doughdata.scenes.tools import finger_mesh
from doughschemas import BadInputError, MissingLayerError
from tests.closed_form import NUM_FRAMES
from tests.dataset_helpers import new_writer, write_examples

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from glTF's y up


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Scene 0 is a ring that is cut twice, scene 1 two bars that merge."""
    path = tmp_path_factory.mktemp("glb") / "cubes"
    write_examples(new_writer(path))
    return open_dataset(path)


def written(dataset: Dataset, path: Path, scene: int, **options: object) -> Path:
    """One export."""
    assert Glb().export(dataset, [scene], path, **options) == (path,)  # type: ignore[arg-type]
    return path


def parts(path: Path) -> dict[str, trimesh.Trimesh]:
    """Every node with a mesh, by name, in our world [m], as trimesh reads it."""
    scene = trimesh.load(path, process=False)
    found = {}
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name].copy()
        mesh.apply_transform(transform)
        found[node] = trimesh.Trimesh(mesh.vertices @ Z_UP.T, mesh.faces, process=False)
    return found


def accessor(gltf: pygltflib.GLTF2, index: int) -> np.ndarray:
    """Floats of an accessor, (elements, width)."""
    entry = gltf.accessors[index]
    view = gltf.bufferViews[entry.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[entry.type]
    assert entry.componentType == pygltflib.FLOAT
    data = gltf.binary_blob()[view.byteOffset :][: view.byteLength]
    return np.frombuffer(data, np.float32).reshape(entry.count, width)


def channels(gltf: pygltflib.GLTF2) -> dict[tuple[int, str], tuple[np.ndarray, np.ndarray]]:
    """Times and values of every animated property: (node, path) -> both."""
    assert len(gltf.animations) == 1
    found = {}
    for channel in gltf.animations[0].channels:
        sampler = gltf.animations[0].samplers[channel.sampler]
        assert sampler.interpolation == "STEP"
        times, values = accessor(gltf, sampler.input)[:, 0], accessor(gltf, sampler.output)
        assert len(times) == len(values)
        assert (np.diff(times) > 0).all()
        found[channel.target.node, channel.target.path] = times, values
    return found


def at(times: np.ndarray, values: np.ndarray, time: float) -> np.ndarray:
    """Value of a STEP sampler."""
    return values[max(int(np.searchsorted(times, time + 1e-6, side="right")) - 1, 0)]


@pytest.mark.parametrize("scene", [0, 1])
@pytest.mark.parametrize("frame", range(NUM_FRAMES))
def test_one_frame_comes_back(dataset: Dataset, tmp_path: Path, scene: int, frame: int) -> None:
    """Every component has its vertices and faces, every finger stands where it stood."""
    found = parts(written(dataset, tmp_path / "one.glb", scene, frame=frame))
    truth = dataset.frame(scene=scene, frame=frame)
    expected = {f"component {k}" for k in range(len(truth.meshes))} | {"finger 0", "finger 1"}
    assert set(found) == expected
    for k, mesh in enumerate(truth.meshes):
        assert np.allclose(found[f"component {k}"].vertices, mesh.vertices, atol=1e-7)
        assert np.array_equal(found[f"component {k}"].faces, mesh.faces)
    finger = np.asarray(finger_mesh(truth.tools.tool).vertices)
    for k in range(2):
        posed = transform_points(finger, truth.tools.position[k], truth.tools.quaternion[k])
        assert np.allclose(found[f"finger {k}"].vertices, posed, atol=1e-6)
        assert found[f"finger {k}"].is_watertight


def test_components_have_their_colours_and_genus(dataset: Dataset, tmp_path: Path) -> None:
    """Two components have two colours; the node of each says its genus."""
    path = written(dataset, tmp_path / "two.glb", 0, frame=2)
    gltf = pygltflib.GLTF2().load(path)
    nodes = [node for node in gltf.nodes if node.name.startswith("component")]
    genus = dataset.frame(scene=0, frame=2).topology.genus
    assert [node.extras["genus"] for node in nodes] == list(genus)
    used = [gltf.meshes[node.mesh].primitives[0].material for node in nodes]
    colours = {tuple(gltf.materials[k].pbrMetallicRoughness.baseColorFactor) for k in used}
    assert len(colours) == len(nodes) == 2


def test_the_last_frame_is_the_default(dataset: Dataset, tmp_path: Path) -> None:
    """Without a frame the file is that of the last key frame."""
    default = written(dataset, tmp_path / "a.glb", 1).read_bytes()
    assert default == written(dataset, tmp_path / "b.glb", 1, frame=NUM_FRAMES - 1).read_bytes()


@pytest.mark.parametrize("scene", [0, 1])
def test_animation_shows_one_frame_at_a_time(dataset: Dataset, tmp_path: Path, scene: int) -> None:
    """From key frame k until the next, frame k alone has scale one, and the fingers its pose."""
    path = written(dataset, tmp_path / "all.glb", scene, animated=True, max_error=0.0)
    gltf = pygltflib.GLTF2().load(path)
    moves = channels(gltf)
    names = {node.name: k for k, node in enumerate(gltf.nodes)}
    frames = [dataset.frame(scene=scene, frame=k) for k in range(NUM_FRAMES)]
    length = frames[-1].timestamp - frames[-2].timestamp
    for k, frame in enumerate(frames):
        for time in (frame.timestamp, frame.timestamp + 0.99 * length):
            scales = [at(*moves[names[f"frame {n:03d}"], "scale"], time) for n in range(NUM_FRAMES)]
            assert [tuple(s) for s in scales] == [(float(n == k),) * 3 for n in range(NUM_FRAMES)]
        for finger in range(2):
            node = names[f"finger {finger}"]
            position = at(*moves[node, "translation"], frame.timestamp)
            rotation = at(*moves[node, "rotation"], frame.timestamp)
            assert np.allclose(position, frame.tools.position[finger], atol=1e-6)
            assert np.allclose(rotation, frame.tools.quaternion[finger], atol=1e-6)


def test_animation_holds_all_meshes(dataset: Dataset, tmp_path: Path) -> None:
    """Each frame's node has that frame's components, with every face where nothing is simplified.

    A viewer that plays no animation shows the first frame alone.
    """
    path = written(dataset, tmp_path / "all.glb", 0, animated=True, max_error=0.0)
    gltf = pygltflib.GLTF2().load(path)
    for k in range(NUM_FRAMES):
        node = next(node for node in gltf.nodes if node.name == f"frame {k:03d}")
        meshes = dataset.frame(scene=0, frame=k).meshes
        indices = [
            gltf.meshes[gltf.nodes[child].mesh].primitives[0].indices for child in node.children
        ]
        assert [gltf.accessors[i].count for i in indices] == [3 * len(m.faces) for m in meshes]
        assert node.scale == [float(k == 0)] * 3


def test_simplified_animation_is_smaller(dataset: Dataset, tmp_path: Path) -> None:
    """By default an animation has fewer faces than the dataset, and a smaller file."""
    full = written(dataset, tmp_path / "full.glb", 0, animated=True, max_error=0.0)
    small = written(dataset, tmp_path / "small.glb", 0, animated=True)
    assert small.stat().st_size < full.stat().st_size


def test_normals_are_unit(dataset: Dataset, tmp_path: Path) -> None:
    """Every normal has length one, as the format asks for."""
    gltf = pygltflib.GLTF2().load(written(dataset, tmp_path / "one.glb", 0))
    found = [p.attributes.NORMAL for m in gltf.meshes for p in m.primitives]
    normals = np.concatenate([accessor(gltf, k) for k in found if k is not None])
    assert len(normals) > 100
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize(
    ("scenes", "name", "options", "message"),
    [
        ([0, 1], "x.glb", {}, "one scene"),
        ([0], "x.obj", {}, "ends in .glb"),
        ([0], "x.glb", {"frame": 1, "animated": True}, "not both"),
        ([0], "x.glb", {"frame": NUM_FRAMES}, "key frame must be"),
        ([0], "x.glb", {"max_error": -1.0}, "positive distance"),
        ([0], "no/folder/x.glb", {}, "cannot write"),
    ],
)
def test_bad_requests_are_refused(
    dataset: Dataset, tmp_path: Path, scenes: list, name: str, options: dict, message: str
) -> None:
    """Each is refused in one clear line, and no file is left behind."""
    with pytest.raises(BadInputError, match=message):
        Glb().export(dataset, scenes, tmp_path / name, **options)
    assert not (tmp_path / name).exists()


def test_a_scene_without_meshes_names_the_command(tmp_path: Path) -> None:
    """The error says which stage to run."""
    write_examples(new_writer(tmp_path / "bare"), layers=("sim", "topology"))
    with pytest.raises(MissingLayerError, match="--stages mesh"):
        Glb().export(open_dataset(tmp_path / "bare"), [0], tmp_path / "x.glb")


def test_command_writes_what_the_exporter_writes(dataset: Dataset, tmp_path: Path) -> None:
    """`doughdata export` hands scene, frame and further options on, and refuses unknown ones."""
    out, uri = tmp_path / "out.glb", dataset.uri
    command("glb", out, uri, scene=[1], frame=2, option=["max_error=0.0005"])
    expected = written(dataset, tmp_path / "x.glb", 1, frame=2, max_error=0.0005)
    assert out.read_bytes() == expected.read_bytes()
    with pytest.raises(BadInputError, match=r"no option 'colour'.*max_error"):
        command("glb", out, uri, scene=[1], option=["colour=red"])
    with pytest.raises(BadInputError, match="NAME=VALUE"):
        command("glb", out, uri, scene=[1], option=["colour"])
    with pytest.raises(BadInputError, match="no scene 7"):
        command("glb", out, uri, scene=[7])
    with pytest.raises(BadInputError, match="does not exist"):
        command("glb", tmp_path / "no" / "x.glb", uri, scene=[0])


def test_exporter_keeps_the_contract() -> None:
    """It needs no arguments and is an Exporter."""
    assert isinstance(Glb(), Exporter)
