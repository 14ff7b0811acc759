"""A plan carried out in the simulator: which shape and topology it really reaches."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from doughcli.build import build_stages
from doughcli.net_gripper import ToolGripper
from doughcli.net_sources import Source
from doughcli.net_surfaces import closed_surface, voxels
from doughdata.dataset import FrameTools
from doughdata.registry import require_package
from doughdata.scene_work import simulate_scene
from doughdata.scenes.limits import check_scene
from doughnet.evaluate import Truth, score_frame
from doughnet.lattice import Lattice, on_lattice, workspace_lattice
from doughnet.model import Shape
from doughschemas import BadInputError, Body, MissingLayerError, Scene

__all__ = ["planned_scene", "shape_bodies", "try_plan"]


def planned_scene(
    start: Source, gripper: ToolGripper, squeeze: Any, *, shape: Shape, folder: Path
) -> Scene:
    """The scene that carries a plan out.

    The dough of a simulated start is that of its scene. What was recorded becomes bodies from the
    model's reconstruction `shape`, whose meshes are written into `folder`.

    Raises:
        BadInputError: the model sees no dough, or the folder cannot be written.
        SceneError: the simulator cannot carry the plan out.
    """
    tool, action = gripper.tool(squeeze.tool), gripper.action(squeeze)
    if start.scene is not None:
        scene = replace(start.scene, tools=(tool,), actions=(action,))
        return check_scene(replace(scene, scene_id=f"{scene.scene_id}-plan", family="custom"))
    bodies = tuple(shape_bodies(shape, folder))
    if not bodies:
        raise BadInputError(f"{start.name}: the model sees no dough there")
    return check_scene(
        Scene(
            scene_id="plan",
            family="custom",
            region="custom",
            bodies=bodies,
            tools=(tool,),
            actions=(action,),
        )
    )


def shape_bodies(shape: Shape, folder: Path) -> Iterator[Body]:
    """A body of every component of a shape; their meshes are written into `folder`.

    Raises:
        BadInputError: the folder cannot be written.
    """
    lattice = workspace_lattice()
    labels, genus = shape.components()
    trimesh = require_package("trimesh", extra="sim")
    for k in range(len(genus)):
        vertices, faces = closed_surface(labels.numpy() == k, lattice)
        mesh = trimesh.Trimesh(vertices, faces)
        mesh = max(mesh.split(), key=lambda part: part.volume, default=None)
        if mesh is None:
            continue
        path = folder / f"start-{k}.glb"
        try:
            mesh.export(path)
        except OSError as error:
            raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error
        x, y, _ = mesh.bounds.mean(axis=0).tolist()
        yield Body(shape="mesh", parameters={"file": str(path)}, position=(x, y))


def try_plan(
    scene: Scene, goal: Source, *, frame: int, num_frames: int, preset: str = "draft"
) -> dict[str, Any]:
    """Simulate, check and mesh; what the goal allows to be compared is compared.

    Args:
        scene: of the plan.
        goal: what was to be reached.
        frame: key frame in which the plan should have reached it.
        num_frames: key frames of the scene.
        preset: resolution of the simulation.

    Raises:
        SimulationError: the plan cannot be carried out.
    """
    names = ("simulate", "topology", "mesh")
    stages = build_stages(
        names, preset=preset, frames=num_frames, arch="cpu", mesher="dual-contouring"
    )
    simulator: Any = stages.simulator
    check: Any = stages.check
    mesher: Any = stages.mesher
    particles = simulate_scene(simulator, scene)
    topology = check.check(scene, particles).frames[frame]
    made = mesher.mesh(particles.positions[frame], topology, spacing=particles.spacing)
    poses = particles.tool_poses
    tools = FrameTools(
        tool=scene.tools[0],
        action=0,
        position=poses.position[frame],
        quaternion=poses.quaternion[frame],
        opening=float(poses.opening[frame]),
    )
    lattice = workspace_lattice()
    reached = on_lattice(made.label_grid, lattice).astype(np.int64)
    found: dict[str, Any] = {
        "genus": sorted(topology.genus),
        "ambiguous": topology.ambiguous_reason,
    }
    truth = _truth(goal, lattice, tools)
    if truth is None:
        return {**found, "goal_genus": None, "topology_reached": None, "viou": None, "ciou": None}
    score = score_frame(reached, topology.genus, truth, lattice)
    return {
        **found,
        "goal_genus": sorted(truth.genus),
        "topology_reached": sorted(truth.genus) == found["genus"],
        "viou": round(100 * score.volume_iou, 2),
        "ciou": round(100 * score.component_iou, 2),
    }


def _truth(goal: Source, lattice: Lattice, tools: FrameTools) -> Truth | None:
    """What is known to be true of a goal: all of a simulated frame or a mesh, nothing of a view."""
    if goal.meshes:
        trimesh = require_package("trimesh", extra="sim")
        eulers = [trimesh.Trimesh(m.vertices, m.faces).euler_number for m in goal.meshes]
        genus = [1 - int(euler) // 2 for euler in eulers]
        return Truth.of(voxels(goal.meshes, lattice), genus, tools)
    if goal.frame is None:
        return None
    try:
        labels = on_lattice(goal.frame.label_grid, lattice)
        return Truth.of(labels, goal.frame.genus, goal.frame.tools)
    except MissingLayerError:
        return None  # a recording
