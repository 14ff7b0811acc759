"""CPU time of one noisy depth view, against trimesh with Embree on the same scene.

python benchmarks/rendering.py --json

A view is everything from meshes to stored depth: building the scene (about 40,000 triangles of
dough, two fingers, the table), casting 640 x 480 rays, the sensor's noise, rounding to 0.1 mm.
trimesh does less: it builds its scene and finds the first hit of the same rays, without noise.
"""

import argparse
import json
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import trimesh

from doughdata.geometry import pixel_rays, quaternion_to_matrix, transform_points
from doughdata.registry import load, names
from doughdata.render.cameras import default_camera
from doughdata.render.depth import DepthRenderer, quantised
from doughdata.scenes.tools import finger_mesh, finger_poses, tool_preset
from doughschemas import Action, Camera, ComponentMesh, Intrinsics


def record(mesh: trimesh.Trimesh) -> ComponentMesh:
    """A trimesh as a record."""
    return ComponentMesh(
        vertices=np.asarray(mesh.vertices, np.float32), faces=np.asarray(mesh.faces, np.uint32)
    )


def make_scene() -> tuple[trimesh.Trimesh, list[trimesh.Trimesh], Camera]:
    """A ring of 40,000 triangles, two fingers beside it, and the paper's pose at 640 x 480."""
    ring = trimesh.creation.torus(0.0225, 0.0075, major_sections=200, minor_sections=100)
    ring.apply_translation([0, 0, 0.0075])
    finger = finger_mesh(tool_preset("regular"))
    fingers = []
    for position, quaternion in zip(*finger_poses(Action(), 0.07), strict=True):
        posed = transform_points(np.asarray(finger.vertices), position, quaternion)
        fingers.append(trimesh.Trimesh(posed, finger.faces, process=False))
    pose = default_camera()
    lens = Intrinsics(width=640, height=480, fx=462.3, fy=461.9, cx=323.6, cy=239.5)
    return ring, fingers, Camera(
        intrinsics=lens, position=pose.position, quaternion=pose.quaternion
    )  # fmt: skip


def cpu_seconds(work: Callable[[], Any], repeats: int) -> float:
    """Least CPU time of one call; the first call, which warms up, does not count."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def view_work(scene: tuple[Any, Any, Camera], sensor: str) -> Callable[[], Any]:
    """One view of the scene by a sensor, from meshes to stored depth."""
    ring, fingers, camera = record(scene[0]), [record(finger) for finger in scene[1]], scene[2]
    model, rng = load("sensors", sensor)(), np.random.default_rng(0)

    def work() -> Any:
        image = DepthRenderer().render([ring], fingers, [camera])[0]
        return quantised(model.observe(image, camera, rng=rng), 1e-4)

    return work


def reference_seconds(
    scene: tuple[Any, Any, Camera], repeats: int
) -> tuple[str | None, float | None]:
    """Name of trimesh's ray engine that is installed, and its CPU time for the same rays."""
    engine = next((name for name in ("embreex", "rtree") if find_spec(name)), None)
    if engine is None:
        return None, None
    ring, fingers, camera = scene
    table = trimesh.creation.box(extents=[4.0, 4.0, 1e-3])
    table.apply_translation([0, 0, -0.5e-3])
    rays = pixel_rays(camera.intrinsics).reshape(-1, 3)
    rays = rays @ quaternion_to_matrix(np.array(camera.quaternion)).T
    # Without Embree one in 64 rays is enough to wait for; the time is scaled up.
    stride = 1 if engine == "embreex" else 64
    rays = rays[::stride]
    origins = np.tile(camera.position, (len(rays), 1))

    def work() -> Any:
        whole = trimesh.util.concatenate([table, *fingers, ring])
        if engine == "embreex":
            caster = trimesh.ray.ray_pyembree.RayMeshIntersector(whole)
        else:
            caster = trimesh.ray.ray_triangle.RayMeshIntersector(whole)
        return caster.intersects_location(origins, rays, multiple_hits=False)

    return f"trimesh + {engine}", cpu_seconds(work, repeats if stride == 1 else 1) * stride


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="CPU time of one noisy depth view")
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--full", action="store_true", help="30 repeats instead of 8")
    options = parser.parse_args()
    repeats, scene = 30 if options.full else 8, make_scene()
    seconds = {name: cpu_seconds(view_work(scene, name), repeats) for name in names("sensors")}
    engine, reference = reference_seconds(scene, repeats)
    ratio = None if reference is None else round(reference / seconds["realsense"], 2)
    result = {
        "benchmark": "rendering",
        "view_cpu_s": round(seconds["realsense"], 4),
        "ratio_to_embreex": ratio if engine == "trimesh + embreex" else None,
        "ratio_to_reference": ratio,
        "reference": engine,  # None: neither embreex nor rtree is installed
        "reference_cpu_s": None if reference is None else round(reference, 4),
        "sensors_cpu_s": {name: round(value, 4) for name, value in seconds.items()},
        "triangles": len(scene[0].faces),
        "width": scene[2].intrinsics.width,
        "height": scene[2].intrinsics.height,
    }
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
