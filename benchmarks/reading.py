"""Cost of reading one full key frame: the direct reader against zarr-python and HDF5.

`python benchmarks/reading.py --json` prints one JSON object on one line. The records are synthetic,
of the size of a real scene (5,000 particles, a mesh of 10,000 vertices, a label grid of 1 mm, a
640 x 480 depth view), and pass through the real writer. zarr-python reads the same files; an HDF5
file holds the same arrays in the same chunks with the same codec (blosc by hdf5plugin with the
writer's settings, Fletcher-32 for crc32c; its cache keeps the arrays of small numbers, but not the
frames, of which a real dataset has more than any cache holds). All readers give the same values,
which is checked; ours reads tables and makes records beside. `samples_per_s` is a DataLoader with
two workers (1024 points, 2048 queries), wall clock.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from doughdata.dataset import Dataset, DatasetSettings, StageRecord, open_dataset, open_writer
from doughdata.dataset.arrays import blosc_settings
from doughschemas import (
    Camera,
    ComponentMesh,
    ComponentMeshes,
    DepthViews,
    FrameTopology,
    Intrinsics,
    LabelGrid,
    Particles,
    SceneGraph,
    ToolPoses,
    Topology,
)

FRAMES = 13  # key frames a scene
H5_CACHE = 2**16  # [bytes] a dataset: keeps decoded small arrays, as our reader does, but no frames
PARTICLES = 5000
CAMERA = Camera(
    intrinsics=Intrinsics(width=640, height=480, fx=460.0, fy=460.0, cx=319.5, cy=239.5),
    position=(0.0, 0.0, 0.5),
    quaternion=(1.0, 0.0, 0.0, 0.0),
)
BATCH = 16  # samples
ROUNDS = 9  # all readers in turns; medians, also of the ratios within a round
Reader = Callable[[int, int], list[np.ndarray]]


def sphere(cells: int, radius: float) -> ComponentMesh:
    """Closed mesh of a sphere [m] from rings of latitude; about `cells`**2 vertices."""
    polar = np.linspace(0, np.pi, cells + 1)[1:-1]
    around = np.linspace(0, 2 * np.pi, cells, endpoint=False)
    p, a = np.meshgrid(polar, around, indexing="ij")
    points = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1)
    poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    vertices = np.concatenate([points.reshape(-1, 3), poles]) * radius + [0, 0, radius]
    ring = np.arange(len(polar) * cells).reshape(len(polar), cells)
    one, two = ring[:-1].ravel(), ring[1:].ravel()
    three = np.roll(ring, -1, axis=1)[1:].ravel()
    four = np.roll(ring, -1, axis=1)[:-1].ravel()
    north, south = ring.size, ring.size + 1
    caps = [
        [np.full(cells, north), ring[0], np.roll(ring[0], -1)],
        [np.full(cells, south), np.roll(ring[-1], -1), ring[-1]],
    ]
    faces = [[one, two, three], [one, three, four], *caps]
    flat = np.concatenate([np.stack(part, axis=1) for part in faces])
    return ComponentMesh(vertices=vertices.astype(np.float32), faces=flat.astype(np.uint32))


def records(seed: int) -> dict[str, Any]:
    """All layers of one scene: a noisy ball that drifts."""
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(PARTICLES, 3)) * 0.01
    drift = (
        np.linspace(0, 0.02, FRAMES)[:, None, None] + rng.normal(size=(FRAMES, PARTICLES, 3)) * 2e-4
    )
    poses = ToolPoses(
        position=np.tile([[0.05, 0, 0], [-0.05, 0, 0]], (FRAMES, 1, 1)).astype(float),
        quaternion=np.tile([0.0, 0, 0, 1], (FRAMES, 2, 1)),
        opening=np.linspace(0.1, 0.001, FRAMES),
        action=np.zeros(FRAMES, np.int32),
    )
    particles = Particles(
        positions=(cloud + drift).astype(np.float32),
        object_ids=np.zeros(PARTICLES, np.uint8),
        timestamps=np.linspace(0, 2, FRAMES),
        tool_poses=poses,
        spacing=0.002,
    )
    graph = SceneGraph(
        positions=np.zeros((1, 3), np.float32),
        components=np.zeros(1, np.uint8),
        particles=np.array([PARTICLES], np.int32),
        edges=np.zeros((0, 2), np.int32),
    )
    none = np.zeros((0, 2), np.int32)
    frame = FrameTopology(
        labels=np.zeros(PARTICLES, np.uint8), genus=(0,), graph=graph, contacts=none
    )
    topology = Topology(
        frames=(frame,) * FRAMES,
        events=(),
        static_num_components=np.ones(FRAMES, np.int32),
        static_genus=((0,),) * FRAMES,
        bonds_made=(none,) * FRAMES,
        bonds_broken=(none,) * FRAMES,
    )
    return {
        "sim": particles,
        "topology": topology,
        "mesh": tuple(_meshes(rng) for _ in range(FRAMES)),
        "depth.none": _depth(rng),
    }


def _meshes(rng: np.random.Generator) -> ComponentMeshes:
    mesh = sphere(100, 0.02)
    noise = rng.normal(scale=1e-5, size=mesh.vertices.shape).astype(np.float32)
    grid = np.full((70, 70, 50), 255, np.uint8)
    axes = np.indices(grid.shape).transpose(1, 2, 3, 0) - [35, 35, 20]
    grid[(axes**2).sum(axis=-1) < 20**2] = 0
    label_grid = LabelGrid(labels=grid, origin=np.array([-0.035, -0.035, 0.0]), spacing=0.001)
    return ComponentMeshes(
        meshes=(replace(mesh, vertices=mesh.vertices + noise),), label_grid=label_grid
    )


def _depth(rng: np.random.Generator) -> DepthViews:
    k = CAMERA.intrinsics
    shape = (FRAMES, k.height, k.width)
    v, u = np.indices(shape[1:])
    ball = (u - k.cx) ** 2 + (v - k.cy) ** 2 < 40**2
    depth = np.where(ball, 4600, 5000) + rng.normal(scale=5, size=shape)
    return DepthViews(
        depth=depth.astype(np.uint16),
        segments=np.broadcast_to(np.where(ball, 16, 1), shape).astype(np.uint8),
        frame_index=np.arange(FRAMES, dtype=np.int32),
        view_index=np.zeros(FRAMES, np.int32),
        cameras=(CAMERA,) * FRAMES,
    )


def make_dataset(path: Path, scenes: int) -> Dataset:
    """Write the synthetic records as one shard."""
    settings = DatasetSettings(num_frames=FRAMES, scenes_per_shard=scenes)
    writer = open_writer(str(path), settings)
    writer.plan_family("rolls", split="train", seed=0, count=scenes)
    made = {index: records(index) for index in range(scenes)}
    for layer in ("sim", "topology", "mesh", "depth.none"):
        (task,) = writer.tasks(layer)
        stage = StageRecord(name="synthetic")
        writer.write(task, {i: made[i][layer] for i in task.scenes}, stage=stage)
    writer.refresh()
    return open_dataset(str(path))


def direct(dataset: Dataset) -> Reader:
    """Everything of a frame through `open_dataset`."""

    def read(scene: int, frame: int) -> list[np.ndarray]:
        opened = dataset.frame(scene=scene, frame=frame)
        particles, topology, (mesh,) = opened.particles, opened.topology, opened.meshes
        views = opened.depth("none")
        return [
            particles.positions, particles.object_ids, topology.labels, mesh.vertices, mesh.faces,
            opened.label_grid.labels, views.depth[0], views.segments[0],
        ]  # fmt: skip

    return read


def plain(dataset: Dataset) -> Reader:
    """The same arrays of the same files through zarr-python, opened once."""
    root = Path(dataset.uri)
    opened: dict[str, Any] = {
        folder.name: zarr.open_array(folder, mode="r")
        for folder in root.glob("data/*/*/arrays.zarr/*")
        if folder.is_dir()
    }
    return _by_name(opened)


def _by_name(opened: dict[str, Any]) -> Reader:
    """Reads the parts of a frame from arrays that are sliced by row."""

    def read(scene: int, frame: int) -> list[np.ndarray]:
        row = scene * FRAMES + frame
        count, vertices = opened["num_particles"][row], opened["vertex_offsets"][row]
        faces, (nx, ny, nz) = opened["face_offsets"][row], opened["label_grid_shape"][row]
        return [
            opened["positions"][row][:count],
            opened["object_ids"][row][:count],
            opened["labels"][row][:count],
            opened["vertices"][row][: vertices[1]],
            opened["faces"][row][: faces[1]],
            opened["label_grid"][row][:nx, :ny, :nz],
            opened["depth"][row],
            opened["segments"][row],
        ]

    return read


def hdf5(dataset: Dataset, file: Path) -> Reader:
    """The same arrays in one HDF5 file, opened once."""
    import h5py
    import hdf5plugin

    folders = Path(dataset.uri).glob("data/*/*/arrays.zarr/*/")
    with h5py.File(file, "w") as target:
        for folder in folders:
            if not (folder / "zarr.json").exists():
                continue
            array = zarr.open_array(folder, mode="r")
            data = np.asarray(array)
            settings = blosc_settings()
            # The HDF5 filter has no argument for it, but blosc heeds this variable.
            os.environ["BLOSC_BLOCKSIZE"] = str(settings["blocksize"])
            codec = hdf5plugin.Blosc(
                cname=settings["cname"],
                clevel=settings["clevel"],
                shuffle=hdf5plugin.Blosc.SHUFFLE,
            )
            chunks = (1, *data.shape[1:])
            written = target.create_dataset(
                folder.name, data=data, chunks=chunks, fletcher32=True, **codec
            )
            if array.chunks == chunks:  # our small arrays lie in one chunk
                size, stored = array.nbytes_stored(), written.id.get_storage_size()
                assert abs(stored - size) < 0.01 * size + 4096, (folder.name, stored, size)
    del os.environ["BLOSC_BLOCKSIZE"]
    opened = h5py.File(file, rdcc_nbytes=H5_CACHE)
    return _by_name({name: opened[name] for name in opened})


def cpu_ms(read: Reader, order: list[tuple[int, int]]) -> float:
    """CPU milliseconds a frame."""
    read(*order[0])
    start = time.process_time()
    for scene, frame in order:
        read(scene, frame)
    return (time.process_time() - start) / len(order) * 1e3


def samples_per_second(dataset: Dataset, epochs: int) -> float | None:
    """A DataLoader with two workers; None where PyTorch is not installed."""
    try:
        from torch.utils.data import DataLoader, RandomSampler

        from doughdata.torch import DoughDataset
    except ModuleNotFoundError:
        return None
    served = DoughDataset(dataset.uri, sensor="none")
    loader = DataLoader(
        served,
        batch_size=BATCH,
        sampler=RandomSampler(served, replacement=True, num_samples=epochs * len(served)),
        num_workers=2,
        persistent_workers=True,
        multiprocessing_context="spawn",
    )
    sum(1 for _ in loader)  # workers start and read their indices
    start = time.perf_counter()
    sum(1 for _ in loader)
    return epochs * len(served) / (time.perf_counter() - start)


def main() -> None:
    """Measure both readers over the same random frames, then the loader."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")
    parser.add_argument("--full", action="store_true", help="32 scenes instead of 6")
    options = parser.parse_args()
    scenes = 32 if options.full else 6
    with tempfile.TemporaryDirectory() as folder:
        dataset = make_dataset(Path(folder) / "dataset", scenes)
        rng = np.random.default_rng(0)
        order = [(int(rng.integers(scenes)), int(rng.integers(FRAMES))) for _ in range(60)]
        readers = direct(dataset), hdf5(dataset, Path(folder) / "all.h5"), plain(dataset)
        for scene, frame in order[:5]:
            for parts in zip(*(read(scene, frame) for read in readers), strict=True):
                assert all(np.array_equal(parts[0], part) for part in parts[1:])
        rounds = [[cpu_ms(read, order) for read in readers] for _ in range(ROUNDS)]
        ours, h5, theirs = np.median(rounds, axis=0).tolist()
        speedup, ratio = (
            np.median([one[k] / one[j] for one in rounds]) for k, j in ((2, 0), (0, 1))
        )
        result = {
            "frame_cpu_ms": round(ours, 3),
            "zarr_frame_cpu_ms": round(theirs, 3),
            "speedup_vs_zarr": round(float(speedup), 2),
            "hdf5_frame_cpu_ms": round(h5, 3),
            "ratio_vs_hdf5": round(float(ratio), 2),
            "samples_per_s": round(samples_per_second(dataset, 8) or 0.0, 1) or None,
            "zarr_version": zarr.__version__,
        }
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
