"""Any record that the types allow comes back as it was, whatever its sizes."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from doughdata.dataset import open_dataset
from doughschemas import (
    NO_COMPONENT,
    STRAY,
    ComponentMesh,
    ComponentMeshes,
    FrameTopology,
    LabelGrid,
    SceneGraph,
)
from tests.closed_form import NUM_FRAMES, cut_ring
from tests.dataset_helpers import equal, new_writer, write_examples

RING = cut_ring()


def random_example(seed: int, particles: int, components: int):
    """Ragged random records; components, vertices, nodes and contacts may be missing."""
    rng = np.random.default_rng(seed)
    base = RING.particles
    shape = (NUM_FRAMES, particles, 3)
    moved = replace(
        base,
        positions=rng.normal(size=shape).astype(np.float32),
        object_ids=rng.integers(0, 3, particles).astype(np.uint8),
    )
    frames = tuple(random_frame(rng, particles, rng.integers(components + 1)) for _ in range(3))
    pairs = [random_pairs(rng, particles) for _ in range(2 * NUM_FRAMES)]
    topology = replace(
        RING.topology,
        frames=frames,
        events=(),
        bonds_made=tuple(pairs[:NUM_FRAMES]),
        bonds_broken=tuple(pairs[NUM_FRAMES:]),
    )
    meshes = tuple(random_meshes(rng, frame.num_components) for frame in frames)
    views = rng.integers(1, 4)
    depth = replace(
        RING.depth,
        depth=rng.integers(0, 2**16, (views, 5, 7)).astype(np.uint16),
        segments=rng.integers(0, 30, (views, 5, 7)).astype(np.uint8),
        frame_index=np.sort(rng.integers(0, NUM_FRAMES, views)).astype(np.int32),
        view_index=np.arange(views, dtype=np.int32),
        cameras=RING.depth.cameras[:1] * int(views),
    )
    return replace(RING, particles=moved, topology=topology, meshes=meshes, depth=depth)


def random_pairs(rng, particles):
    return rng.integers(0, particles, (rng.integers(4), 2)).astype(np.int32)


def random_frame(rng, particles, components):
    nodes = rng.integers(0, 5)
    graph = SceneGraph(
        positions=rng.normal(size=(nodes, 3)).astype(np.float32),
        components=rng.integers(0, 3, nodes).astype(np.uint8),
        particles=rng.integers(0, 99, nodes).astype(np.int32),
        edges=random_pairs(rng, 9),
    )
    return FrameTopology(
        labels=rng.choice([0, 1, STRAY], particles).astype(np.uint8),
        genus=tuple(int(g) for g in rng.integers(0, 3, components)),
        graph=graph,
        contacts=random_pairs(rng, particles),
        ambiguous_reason=str(rng.choice(["", "a neck of 2.9 spacings"])),
    )


def random_meshes(rng, components):
    meshes = tuple(
        ComponentMesh(
            vertices=rng.normal(size=(rng.integers(9), 3)).astype(np.float32),
            faces=rng.integers(0, 9, (rng.integers(9), 3)).astype(np.uint32),
        )
        for _ in range(components)
    )
    labels = rng.choice([0, 1, NO_COMPONENT], rng.integers(1, 6, 3)).astype(np.uint8)
    grid = LabelGrid(labels=labels, origin=rng.normal(size=3), spacing=0.001)
    return ComponentMeshes(meshes=meshes, label_grid=grid)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(0, 4), st.integers(1, 3))
def test_random_records_come_back(seed, particles, components, scenes_per_shard):
    """Ragged sizes, empty parts and several scenes a shard do not change a bit."""
    examples = [
        replace(
            random_example(seed + k, particles + 3 * k, components),
            scene=replace(RING.scene, scene_id=f"scene-{k}"),
        )
        for k in range(3)
    ]
    with tempfile.TemporaryDirectory() as folder:
        writer = new_writer(Path(folder) / "dataset", scenes_per_shard=scenes_per_shard)
        write_examples(writer, examples)
        dataset = open_dataset(writer.uri)
        for index, example in enumerate(examples):
            assert equal(dataset.read_particles(index), example.particles)
            assert equal(dataset.read_topology(index), example.topology)
            assert equal(dataset.read_depth(index, "none"), example.depth)
            for k in range(NUM_FRAMES):
                assert equal(dataset.read_meshes(index, k), example.meshes[k])
