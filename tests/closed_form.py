"""Two small scenes whose every value is known by construction: dough made of whole cubes.

A cube of side SPACING stands for one particle at its centre, so volumes, surfaces, labels, genus
and depth images follow by counting. `cut_ring`: a square ring is cut once (genus 1 -> 0), then
again (1 -> 2 components). `joined_bars`: two bars come nearer, touch (still 2) and merge (1).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from doughdata.scenes import finger_poses, tool_preset
from doughschemas import (
    NO_COMPONENT,
    SEGMENT_COMPONENT,
    SEGMENT_TABLE,
    Action,
    Body,
    Camera,
    ComponentMesh,
    ComponentMeshes,
    DepthViews,
    FrameTopology,
    Intrinsics,
    LabelGrid,
    Particles,
    Scene,
    SceneGraph,
    ToolPoses,
    Topology,
    TopologyEvent,
)

SPACING = 0.002  # [m], side of a cube
NUM_FRAMES = 3
CAMERA = Camera(  # 0.3 m above the origin, looking straight down
    intrinsics=Intrinsics(width=40, height=32, fx=200.0, fy=200.0, cx=19.5, cy=15.5),
    position=(0.0, 0.0, 0.3),
    quaternion=(1.0, 0.0, 0.0, 0.0),
)
SIDES = np.array([a for k in range(3) for a in (np.eye(3, dtype=int)[k], -np.eye(3, dtype=int)[k])])


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A scene and the records of all its layers."""

    scene: Scene
    particles: Particles
    topology: Topology
    meshes: tuple[ComponentMeshes, ...]
    depth: DepthViews


def cut_ring() -> Example:
    """8 x 8 x 3 cubes around a hole of 4 x 4; the cut dough is heaped beside each cut."""
    cells = np.array([c for c in product(range(8), range(8), range(3)) if not _in_hole(c)])
    cells = cells - [4, 4, 0]
    middle = (cells[:, 0] >= -1) & (cells[:, 0] <= 0)
    first, second = middle & (cells[:, 1] < -2), middle & (cells[:, 1] > 1)
    side = np.where(cells[:, 0] < 0, -1, 1)
    one, two = cells.copy(), cells.copy()
    one[first] += np.stack([side[first], 0 * side[first], 3 + 0 * side[first]], axis=1)
    both = first | second
    two[both] += np.stack([side[both], 0 * side[both], 3 + 0 * side[both]], axis=1)
    two[:, 0] += side
    labels = (np.zeros(len(cells), int), np.zeros(len(cells), int), (side > 0).astype(int))
    corners = np.array([[-3, -3], [3, -3], [3, 3], [-3, 3]]) * SPACING
    nodes = np.column_stack([corners, np.full(4, 1.5 * SPACING)])
    quarter = len(cells) // 4
    graphs = (
        _graph(nodes, [0] * 4, [quarter] * 4, [(0, 1), (1, 2), (2, 3), (0, 3)]),
        _graph(nodes, [0] * 4, [quarter] * 4, [(1, 2), (2, 3), (0, 3)]),
        _graph(nodes[[0, 1]], [0, 1], [2 * quarter] * 2, []),
    )
    events = (
        TopologyEvent(
            frame=1, kind="self_split", components_before=(0,), components_after=(0,), margin=0.5
        ),
        TopologyEvent(
            frame=2, kind="split", components_before=(0,), components_after=(0, 1), margin=0.75
        ),
    )
    scene = _scene("closed-form-cut-ring", Body(shape="ring"))
    genus = ((1,), (0,), (0, 0))
    frames = (cells, one, two)
    return _example(scene, frames, labels, genus, graphs, events, static_genus=genus)


def joined_bars() -> Example:
    """Two bars of 4 x 10 x 3 cubes: 2 cubes apart, touching, merged."""
    bar = np.array(list(product(range(4), range(10), range(3)))) - [0, 5, 0]
    left = np.arange(2 * len(bar)) < len(bar)

    def cells(gap: int) -> np.ndarray:
        return np.concatenate(
            [bar - np.array([4 + gap // 2, 0, 0]), bar + np.array([gap - gap // 2, 0, 0])]
        )

    apart, joined = (~left).astype(int), np.zeros(2 * len(bar), int)
    touch = cells(0)
    faces = [(a, b) for a, b in _neighbours(touch) if left[a] != left[b]]
    nodes = np.array([[-2.0, 0, 1.5], [2.0, 0, 1.5]]) * SPACING
    count = [len(bar)] * 2
    graphs = (
        _graph(nodes * [1.5, 1, 1], [0, 1], count, []),
        _graph(nodes, [0, 1], count, []),
        _graph(nodes, [0, 0], count, [(0, 1)]),
    )
    event = TopologyEvent(
        frame=2, kind="merge", components_before=(0, 1), components_after=(0,), margin=1.25
    )
    bodies = [Body(shape="roll", position=(x, 0.0)) for x in (-0.011, 0.011)]
    scene = _scene("closed-form-joined-bars", *bodies)
    labels = (apart, apart, joined)
    genus = ((0, 0), (0, 0), (0,))
    frames = (cells(2), touch, touch)
    return _example(
        scene,
        frames,
        labels,
        genus,
        graphs,
        (event,),
        contacts=((), faces, ()),
        static_genus=((0, 0), (0,), (0,)),  # the static check takes touching for merged
    )


def _in_hole(cell: tuple[int, ...]) -> bool:
    return 2 <= cell[0] < 6 and 2 <= cell[1] < 6


def _scene(scene_id: str, *bodies: Body) -> Scene:
    action = Action(opening_end=0.004, speed=0.025)
    return Scene(
        scene_id=scene_id,
        family="custom",
        region="custom",
        bodies=bodies,
        tools=(tool_preset("regular"),),
        actions=(action,),
    )


def _graph(nodes: np.ndarray, components: list, particles: list, edges: list) -> SceneGraph:
    return SceneGraph(
        positions=np.asarray(nodes, np.float32),
        components=np.array(components, np.uint8),
        particles=np.array(particles, np.int32),
        edges=np.array(edges, np.int32).reshape(-1, 2),
    )


def _example(
    scene, cells, labels, genus, graphs, events, *, contacts=((), (), ()), static_genus
) -> Example:
    frames = tuple(
        FrameTopology(
            labels=labels[k].astype(np.uint8),
            genus=genus[k],
            graph=graphs[k],
            contacts=np.array(contacts[k], np.int32).reshape(-1, 2),
        )
        for k in range(NUM_FRAMES)
    )
    bonds = [
        {(a, b) for a, b in _neighbours(c) if lab[a] == lab[b]}
        for c, lab in zip(cells, labels, strict=True)
    ]
    topology = Topology(
        frames=frames,
        events=events,
        static_num_components=np.array([len(g) for g in static_genus], np.int32),
        static_genus=static_genus,
        bonds_made=tuple(_pairs(b - (bonds[k - 1] if k else set())) for k, b in enumerate(bonds)),
        bonds_broken=tuple(_pairs((bonds[k - 1] if k else set()) - b) for k, b in enumerate(bonds)),
    )
    return Example(
        scene=scene,
        particles=_particles(scene, cells),
        topology=topology,
        meshes=tuple(_meshes(c, lab) for c, lab in zip(cells, labels, strict=True)),
        depth=_depth(cells, labels),
    )


def _particles(scene: Scene, cells: tuple) -> Particles:
    positions = np.stack([(c + 0.5) * SPACING for c in cells]).astype(np.float32)
    action = scene.actions[0]
    openings = np.linspace(action.opening_start, action.opening_end, NUM_FRAMES)
    poses = [finger_poses(action, opening) for opening in openings]
    return Particles(
        positions=positions,
        object_ids=np.zeros(positions.shape[1], np.uint8),
        timestamps=np.linspace(0.0, scene.duration, NUM_FRAMES),
        tool_poses=ToolPoses(
            position=np.stack([p for p, _ in poses]),
            quaternion=np.stack([q for _, q in poses]),
            opening=openings,
            action=np.zeros(NUM_FRAMES, np.int32),
        ),
        spacing=SPACING,
    )


def _neighbours(cells: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of particles whose cubes share a face."""
    place = {tuple(c): k for k, c in enumerate(cells.tolist())}
    pairs = []
    for cell, k in place.items():
        for side in SIDES:
            other = place.get(tuple((np.array(cell) + side).tolist()))
            if other is not None and k < other:
                pairs.append((k, other))
    return pairs


def _pairs(bonds: set) -> np.ndarray:
    return np.array(sorted(bonds), np.int32).reshape(-1, 2)


def _meshes(cells: np.ndarray, labels: np.ndarray) -> ComponentMeshes:
    meshes = tuple(_boundary(cells[labels == k]) for k in range(labels.max() + 1))
    low, high = cells.min(axis=0) * 2 - 2, cells.max(axis=0) * 2 + 5  # in millimetres
    owner = {tuple(c): lab for c, lab in zip(cells.tolist(), labels, strict=True)}
    grid = np.full(high - low, NO_COMPONENT, np.uint8)
    for node in np.ndindex(*grid.shape):
        cell = tuple(((np.array(node) + low) // 2).tolist())  # the cube that holds this node
        grid[node] = owner.get(cell, NO_COMPONENT)
    origin = low * (SPACING / 2)
    return ComponentMeshes(
        meshes=meshes, label_grid=LabelGrid(labels=grid, origin=origin, spacing=SPACING / 2)
    )


def _boundary(cells: np.ndarray) -> ComponentMesh:
    """Outer faces of the cubes, two triangles each, with shared vertices."""
    place, vertices, faces = {tuple(c) for c in cells.tolist()}, {}, []
    for cell in sorted(place):
        for side in SIDES:
            if tuple((np.array(cell) + side).tolist()) in place:
                continue
            axis = int(np.flatnonzero(side)[0])
            u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
            base = np.array(cell) + np.maximum(side, 0)
            ring = [base, base + u, base + u + v, base + v]
            if side[axis] < 0:
                ring.reverse()
            a, b, c, d = (vertices.setdefault(tuple(p.tolist()), len(vertices)) for p in ring)
            faces += [(a, b, c), (a, c, d)]
    points = np.array(list(vertices), float) * SPACING
    return ComponentMesh(vertices=points.astype(np.float32), faces=np.array(faces, np.uint32))


def _depth(cells: tuple, labels: tuple) -> DepthViews:
    images = [_image(c, lab) for c, lab in zip(cells, labels, strict=True)]
    return DepthViews(
        depth=np.stack([np.rint(z / 1e-4).astype(np.uint16) for z, _ in images]),
        segments=np.stack([segment for _, segment in images]),
        frame_index=np.arange(NUM_FRAMES, dtype=np.int32),
        view_index=np.zeros(NUM_FRAMES, np.int32),
        cameras=(CAMERA,) * NUM_FRAMES,
    )


def _image(cells: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact depth [m] of axis-parallel cubes and the table, by the slab method."""
    k, height = CAMERA.intrinsics, CAMERA.position[2]
    u, v = np.meshgrid(np.arange(k.width), np.arange(k.height))
    ray = np.stack([(u - k.cx) / k.fx, -(v - k.cy) / k.fy, -np.ones_like(u, float)], axis=-1)
    depth = np.full(u.shape, height)
    segment = np.full(u.shape, SEGMENT_TABLE, np.uint8)
    for cell, label in zip(cells, labels, strict=True):
        planes = (np.stack([cell, cell + 1]) * SPACING - np.array(CAMERA.position))[:, None, None]
        times = planes / ray
        enter, leave = times.min(axis=0).max(axis=-1), times.max(axis=0).min(axis=-1)
        hit = (enter <= leave) & (enter < depth)
        depth[hit], segment[hit] = enter[hit], SEGMENT_COMPONENT + label
    return depth, segment
