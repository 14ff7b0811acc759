"""glTF binary: one key frame, or a whole scene as an animation, for Blender and any web viewer.

Meshes change their topology from frame to frame, so no vertex can be moved from one to the next.
An animation holds all frames' meshes and shows one at a time: the others have scale zero, which
glTF 2.0 names as the way to animate visibility.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from doughdata.dataset import Dataset, Frame
from doughdata.exporters.gltf import Gltf
from doughdata.mesh.simplify import simplify
from doughdata.registry import require_package
from doughdata.scenes.tools import finger_mesh
from doughdata.view.panels import COLOURS
from doughschemas import BadInputError, ComponentMesh, Scene

__all__ = ["Glb"]

STEEL = np.array([0.36, 0.39, 0.44])  # sRGB
ONE, NONE = [1.0] * 3, [0.0] * 3  # scale of what is shown, and of what is not
SIMPLIFY = 4e-4  # [m], for animations: under half the faces


class Glb:
    """Component meshes, coloured by component, and the fingers of the gripper.

    In metres. Nodes are named `frame 042`, `component 1`, `finger 0`; a component's node says its
    genus in `extras`.
    """

    def export(
        self,
        dataset: Dataset,
        scenes: Sequence[int],
        out: Path,
        *,
        frame: int | None = None,
        animated: bool = False,
        max_error: float | None = None,
    ) -> tuple[Path, ...]:
        """Write one scene.

        Args:
            dataset: with the layer `mesh`.
            scenes: exactly one scene index.
            out: path that ends in `.glb`.
            frame: key frame; by default the last one.
            animated: all key frames, at the times of the simulation, one shown at a time.
            max_error: how far simplification may move a surface [m]; 0 = keep every face. By
                default 0.4 mm in an animation, which keeps it at about 0.15 MB a key frame, and 0
                in a single frame.

        Raises:
            BadInputError: not one scene, both `frame` and `animated`, a path that is no `.glb` or
                cannot be written.
            MissingLayerError: the scene has no meshes.
        """
        _check(scenes, out, frame=frame, animated=animated)
        bound = (SIMPLIFY if animated else 0.0) if max_error is None else max_error
        last = dataset.num_frames - 1
        keys = range(last + 1) if animated else [last if frame is None else frame]
        data = _file(dataset, scenes[0], keys, bound)
        try:
            out.write_bytes(data)
        except OSError as error:
            raise BadInputError(f"cannot write {out}: {error.strerror or error}") from error
        return (out,)


def _check(scenes: Sequence[int], out: Path, *, frame: int | None, animated: bool) -> None:
    if len(scenes) != 1:
        raise BadInputError(f"a .glb holds one scene, got {len(scenes)}: name it with --scene I")
    if out.suffix.lower() != ".glb":
        raise BadInputError(f"glb is written to a path that ends in .glb, got {out}")
    if animated and frame is not None:
        raise BadInputError("give either a frame or animated, not both")


def _file(dataset: Dataset, index: int, keys: Sequence[int], max_error: float) -> bytes:
    """The bytes of a file with these key frames."""
    frames = [dataset.frame(scene=index, frame=key) for key in keys]
    scene = dataset.scene(index)
    gltf = Gltf(f"scene {index} ({scene.scene_id})")
    times = np.array([frame.timestamp for frame in frames]) - frames[0].timestamp
    if len(frames) > 1:  # the last key frame is shown as long as the one before
        times = np.append(times, 2 * times[-1] - times[-2])
    most = max(len(frame.meshes) for frame in frames)
    dough = [
        gltf.material(f"component {k}", colour, roughness=0.8)
        for k, colour in enumerate(COLOURS[:most])
    ]
    for number, frame in enumerate(frames):
        node = gltf.node(f"frame {frame.frame_index:03d}", scale=NONE if number else ONE)
        _add_components(gltf, node, frame, dough, max_error)
        _show(gltf, node, times, [k == number for k in range(len(frames))])
    _add_fingers(gltf, scene, frames, times)
    return gltf.to_bytes()


def _add_components(
    gltf: Gltf, parent: int, frame: Frame, materials: Sequence[int], max_error: float
) -> None:
    """Nodes of a key frame's components; an empty mesh gets none, glTF knows no such thing."""
    meshes: Iterable[ComponentMesh] = frame.meshes
    if max_error:
        meshes = simplify(frame.meshes, max_error=max_error)
    for k, (mesh, genus) in enumerate(zip(meshes, frame.genus, strict=True)):
        if not len(mesh.faces):
            continue
        name = f"component {k}"
        number = gltf.mesh(
            f"frame {frame.frame_index:03d} {name}",
            mesh.vertices,
            mesh.faces,
            material=materials[k % len(materials)],
            normals=_normals(mesh),
        )
        gltf.node(name, parent=parent, mesh=number, extras={"component": k, "genus": genus})


def _add_fingers(gltf: Gltf, scene: Scene, frames: Sequence[Frame], times: np.ndarray) -> None:
    """Two nodes for each tool in use, posed at every key frame, shown while its turn lasts."""
    steel = gltf.material("finger", STEEL, roughness=0.4)
    used = [scene.actions[frame.tools.action].tool for frame in frames]
    for tool in dict.fromkeys(used):
        mesh = finger_mesh(scene.tools[tool])
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        number = gltf.mesh(f"finger {scene.tools[tool].name}", vertices, faces, material=steel)
        shown = [k == tool for k in used]
        for finger in range(2):
            position = np.array([frame.tools.position[finger] for frame in frames])
            rotation = np.array([frame.tools.quaternion[finger] for frame in frames])
            node = gltf.node(
                f"finger {finger}",
                mesh=number,
                translation=position[0].tolist(),
                rotation=rotation[0].tolist(),
                scale=ONE if shown[0] else NONE,
            )
            if len(frames) > 1:
                gltf.animate(node, "translation", times[:-1], position)
                gltf.animate(node, "rotation", times[:-1], rotation)
                _show(gltf, node, times, shown)


def _show(gltf: Gltf, node: int, times: np.ndarray, shown: Sequence[bool]) -> None:
    """Keys where a node appears or goes; none if it never does. `times` has the end, too."""
    if all(shown):
        return
    state = np.array([*shown, shown[-1]], np.float64)
    keys = np.flatnonzero(np.r_[True, state[1:] != state[:-1]])
    keys = np.union1d(keys, [len(state) - 1])
    gltf.animate(node, "scale", times[keys], np.repeat(state[keys, None], 3, axis=1))


def _normals(mesh: ComponentMesh) -> Float32[np.ndarray, "vertices 3"]:
    """Unit normals of the vertices by trimesh; up where a vertex has none."""
    trimesh = require_package("trimesh", extra="sim")
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    normals = np.array(surface.vertex_normals, np.float64)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.5)
    unit[length[:, 0] <= 0.5] = [0.0, 0.0, 1.0]
    return unit.astype(np.float32)
