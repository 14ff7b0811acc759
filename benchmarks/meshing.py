"""Cost and quality of meshing one frame, over deformed states of rolls and rings.

`python benchmarks/meshing.py --json` prints one JSON object on one line. The states are solids in
closed form, sampled with particles 2 mm apart and then squeezed to 0.45x or stretched to 2x at
constant volume, so that the benchmark needs no simulator. `--full` takes more states.
`--frames 200` takes key frames of simulated and checked scenes of both families instead (minutes),
`--dataset URI` those of a dataset that holds them already.
"""

import argparse
import json
import time
from collections.abc import Iterator
from itertools import islice, product

import numpy as np

from doughdata import registry
from doughdata.mesh.checks import is_edge_manifold, is_vertex_manifold, mesh_genus, mesh_volume
from doughdata.stages import Mesher
from doughschemas import ComponentMesh, FrameTopology, SceneGraph

SPACING = 0.002  # [m]
Cloud = np.ndarray


def roll(x: float, *, radius: float = 0.010, length: float = 0.060, seed: int = 0) -> Cloud:
    """Jittered lattice inside a cylinder along y that lies on the table [m]."""
    points = _lattice((-radius, -length / 2, 0.0), (radius, length / 2, 2 * radius), seed)
    inside = points[:, 0] ** 2 + (points[:, 2] - radius) ** 2 < radius**2
    return points[inside] + [x, 0.0, 0.0]


def ring(*, radius: float = 0.0225, tube: float = 0.0085, seed: int = 0) -> Cloud:
    """Jittered lattice inside a torus that lies on the table [m]."""
    outer = radius + tube
    points = _lattice((-outer, -outer, 0.0), (outer, outer, 2 * tube), seed)
    across = np.hypot(points[:, 0], points[:, 1]) - radius
    return points[across**2 + (points[:, 2] - tube) ** 2 < tube**2]


def squeeze(cloud: Cloud, *, factor: float, width: float) -> Cloud:
    """Narrow x by `factor` within `width` [m] of y = 0 and raise z as much: keeps volume."""
    local = 1.0 + (factor - 1.0) * np.exp(-((cloud[:, 1] / width) ** 2))
    return cloud * np.stack([local, np.ones(len(cloud)), 1.0 / local], axis=1)


def frames(count: int) -> list[tuple[Cloud, FrameTopology]]:
    """Rolls apart and in contact, rings and stretched rolls, ever more deformed."""
    states = []
    for step in range(count):
        factor = 1.0 - 0.55 * step / max(count - 1, 1)
        pair = [roll(-0.0105, seed=step), roll(0.0105, seed=step + 1)]
        states.append([squeeze(c, factor=factor, width=0.015) for c in pair])
        states.append([squeeze(ring(seed=step), factor=factor, width=0.012)])
        long = 1.0 + step / max(count - 1, 1)
        stretched = roll(0.0, length=0.120, seed=step) * [long**-0.5, long, long**-0.5]
        states.append([stretched])
    genera = [(0, 0), (1,), (0,)] * count
    return [_frame(clouds, genus) for clouds, genus in zip(states, genera, strict=True)]


def measure(mesher: Mesher, states: list[tuple[Cloud, FrameTopology]]) -> dict[str, float | int]:
    """Figures over all states; the first is meshed once more before, to load what is needed."""
    mesher.mesh(states[0][0], states[0][1], spacing=SPACING)
    start = time.process_time()
    results = [mesher.mesh(x, topology, spacing=SPACING) for x, topology in states]
    seconds = time.process_time() - start
    meshes = [mesh for result in results for mesh in result.meshes]
    genera = [genus for _, topology in states for genus in topology.genus]
    wanted = [
        np.count_nonzero(topology.labels == label) * SPACING**3
        for _, topology in states
        for label in range(topology.num_components)
    ]
    errors = [
        abs(mesh_volume(mesh.vertices, mesh.faces) / volume - 1.0)
        for mesh, volume in zip(meshes, wanted, strict=True)
    ]
    return {
        "frames": len(states),
        "frame_cpu_s": round(seconds / len(states), 4),
        "particles": int(np.mean([len(x) for x, _ in states])),
        "faces": int(np.mean([sum(len(m.faces) for m in r.meshes) for r in results])),
        "watertight": float(np.mean([is_edge_manifold(m.faces) for m in meshes])),
        "manifold": float(np.mean([is_vertex_manifold(m.faces) for m in meshes])),
        "overlap_mm3": round(max(_overlap(r.meshes) for r in results) * 1e9, 6),
        "volume_error_max": round(float(max(errors)), 5),
        "genus_of_label": float(
            np.mean([mesh_genus(m.faces) == g for m, g in zip(meshes, genera, strict=True)])
        ),
        "self_intersecting": float(np.mean([any(map(_cuts_itself, r.meshes)) for r in results])),
    }


def simulated_frames(count: int) -> list[tuple[Cloud, FrameTopology]]:
    """Every third key frame of scenes of both families, as `doughdata generate` makes them."""
    from doughdata.scene_work import simulate_scene
    from doughdata.sim.mpm import MpmSimulator, draft
    from doughdata.sim.pull import MpmPullApart

    simulator = MpmSimulator(draft())
    check = registry.load("topology", "dynamic")(pull_apart=MpmPullApart())

    def states() -> Iterator[tuple[Cloud, FrameTopology]]:
        for number, family in product(range(count), ("rolls", "doughnut")):
            scene = registry.load("scenes", family)().sample(seed=0, number=number, split="train")
            particles = simulate_scene(simulator, scene)
            topology = check.check(scene, particles)
            yield from list(zip(particles.positions, topology.frames, strict=True))[::3]

    return list(islice(states(), count))


def stored_frames(uri: str, count: int) -> list[tuple[Cloud, FrameTopology]]:
    """Key frames of a dataset with 2 mm particles, evenly spread."""
    from doughdata import open_dataset

    dataset = open_dataset(uri)
    keys = list(product(dataset.scene_indices, range(dataset.num_frames)))
    chosen = np.unique(np.linspace(0, len(keys) - 1, min(count, len(keys))).round().astype(int))
    stored = [dataset.frame(scene=keys[k][0], frame=keys[k][1]) for k in chosen]
    return [(frame.particles.positions, frame.topology) for frame in stored]


def _lattice(low: tuple[float, ...], high: tuple[float, ...], seed: int) -> Cloud:
    rng = np.random.default_rng(seed)
    axes = [np.arange(a + SPACING / 2, b, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return points + rng.uniform(-0.2, 0.2, points.shape) * SPACING


def _frame(clouds: list[Cloud], genus: tuple[int, ...]) -> tuple[Cloud, FrameTopology]:
    sizes = [len(cloud) for cloud in clouds]
    components = np.arange(len(clouds), dtype=np.uint8)
    graph = SceneGraph(
        positions=np.array([cloud.mean(axis=0) for cloud in clouds], np.float32),
        components=components,
        particles=np.array(sizes, np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    topology = FrameTopology(
        labels=np.repeat(components, sizes),
        genus=genus,
        graph=graph,
        contacts=np.zeros((0, 2), np.int32),
    )
    return np.concatenate(clouds).astype(np.float32), topology


def _overlap(meshes: tuple[ComponentMesh, ...]) -> float:
    """Largest volume [m3] that two meshes share, by manifold3d."""
    import manifold3d

    solids = [
        manifold3d.Manifold(manifold3d.Mesh64(m.vertices.astype(np.float64), m.faces))
        for m in meshes
    ]
    shared = [(a ^ b).volume() for i, a in enumerate(solids) for b in solids[:i]]
    return max(shared, default=0.0)


def _cuts_itself(mesh: ComponentMesh) -> bool:
    """Whether two triangles of a mesh intersect, by Open3D."""
    import open3d

    vertices = open3d.utility.Vector3dVector(mesh.vertices.astype(np.float64) * 1e3)
    faces = open3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    return len(open3d.geometry.TriangleMesh(vertices, faces).get_self_intersecting_triangles()) > 0


def main() -> None:
    """Measure every registered mesher; the figures at the top level are the default's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--full", action="store_true", help="60 states instead of 12")
    parser.add_argument("--frames", type=int, metavar="N", help="N simulated key frames instead")
    parser.add_argument("--dataset", metavar="URI", help="take them from this dataset")
    parser.add_argument("--mesher", action="append", metavar="NAME", help="default: every one")
    options = parser.parse_args()
    if options.dataset:
        states = stored_frames(options.dataset, options.frames or 200)
    elif options.frames:
        states = simulated_frames(options.frames)
    else:
        states = frames(20 if options.full else 4)
    results = {
        name: measure(registry.load("meshers", name)(), states)
        for name in options.mesher or registry.names("meshers")
    }
    first = results.pop("dual-contouring", {})
    result = {"benchmark": "meshing", **first, **results}
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
