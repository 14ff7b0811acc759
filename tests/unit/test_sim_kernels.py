"""The Taichi functions of contact and interpolation, judged by numpy."""

import numpy as np
import pytest

from doughdata.scenes import PRESETS, finger_poses
from doughdata.scenes.sdf import MARGIN, SignedDistanceGrid, finger_sdf
from doughdata.sim import contact as rigid
from doughdata.sim._taichi import start, ti
from doughdata.sim.arrays import Integers, Nodes, Scalars, Vectors
from doughdata.sim.stress import Mat3, Vec3
from doughdata.sim.transfers import weights
from doughschemas import Action, Tool

start("cpu")
YAW, GAP, OPENING = 0.6, (0.012, -0.007), 0.031


@ti.kernel
def run_frames(p: Vectors, local: Vectors, back: Vectors, finger: ti.i32, contact: rigid.Contact):
    for i in range(p.shape[0]):
        local[i] = rigid.finger_local(p[i], finger, contact.opening, contact)
        back[i] = rigid.finger_world(p[i], finger, contact)


@ti.kernel
def run_sample(p: Vectors, sdf: Scalars, found: Nodes, held: Integers, contact: rigid.Contact):
    for i in range(p.shape[0]):
        distance, gradient = rigid.sdf_sample(p[i], sdf, contact)
        found[i] = rigid.Vec4(gradient[0], gradient[1], gradient[2], distance)
        held[i] = rigid.sdf_holds(p[i], 0.001, contact)


@ti.kernel
def run_coulomb(v: Vectors, wall: Vectors, normal: Vectors, after: Vectors, friction: ti.f32):
    for i in range(v.shape[0]):
        after[i] = rigid.coulomb(v[i], wall[i], normal[i], friction)


@ti.kernel
def run_weights(
    p: Vectors, base: Vectors, w: ti.types.ndarray(dtype=Mat3, ndim=1), grid: rigid.Grid
):
    for i in range(p.shape[0]):
        b, _, w0, w1, w2 = weights(p[i], grid)
        base[i] = ti.cast(b, ti.f32)
        for d in ti.static(range(3)):
            w[i][0, d] = w0[d]
            w[i][1, d] = w1[d]
            w[i][2, d] = w2[d]


@ti.kernel
def run_find(
    sdf: Scalars, colliders: Nodes, free: Scalars, grid: rigid.Grid, contact: rigid.Contact
):
    for _ in range(1):
        rigid.find_fingers(
            rigid.Int3(0, 0, 0), grid.shape, contact.opening, sdf, colliders, free, grid, contact
        )


def contact_of(sdf: SignedDistanceGrid, *, beyond: float = 0.0) -> rigid.Contact:
    """Fingers at the pose of this module."""
    return rigid.Contact(
        fingers=2,
        gap=Vec3(*GAP, 0.0),
        axis=Vec3(np.cos(YAW), np.sin(YAW), 0.0),
        opening=OPENING,
        rate=0.0,
        friction=0.3,
        table_friction=0.5,
        band=0.0015,
        sdf_origin=Vec3(*sdf.origin),
        sdf_spacing=sdf.spacing,
        sdf_shape=rigid.Int3(*sdf.values.shape),
        sdf_beyond=beyond,
    )


def random_points(low, high, *, seed: int, count: int = 2_000) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 3)).astype(np.float32)


@pytest.mark.parametrize("finger", [0, 1])
def test_finger_frames(finger: int) -> None:
    """World -> finger frame agrees with the poses that `finger_poses` reports."""
    points = random_points(-0.06, 0.06, seed=0)
    local, turned = np.zeros_like(points), np.zeros_like(points)
    run_frames(points, local, turned, finger, contact_of(finger_sdf(PRESETS["regular"])))
    position, quaternion = finger_poses(Action(position=GAP, yaw=YAW), OPENING)
    angle = 2 * np.arctan2(quaternion[finger, 2], quaternion[finger, 3])
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert np.abs(local - (points - position[finger]) @ rotation).max() < 1e-7
    assert np.abs(turned - points @ rotation.T).max() < 1e-7


def test_sdf_sample() -> None:
    """Distance is the trilinear one of the record, the gradient its unit derivative."""
    sdf = finger_sdf(PRESETS["regular"])
    points = random_points([-0.008, -0.013, -0.008], [0.018, 0.013, 0.058], seed=1)
    found, held = np.zeros((len(points), 4), np.float32), np.zeros(len(points), np.int32)
    run_sample(points, sdf.values.reshape(-1), found, held, contact_of(sdf))
    assert held.all()
    assert np.abs(found[:, 3] - sdf.sample(points.astype(np.float64))).max() < 2e-8
    assert np.abs(np.linalg.norm(found[:, :3], axis=1) - 1).max() < 1e-5
    step, slope = 1e-6, np.zeros((len(points), 3))
    index = (points - sdf.origin) / sdf.spacing
    smooth = (np.abs(index - np.round(index)) > 0.01).all(axis=1)  # no kink within the step
    for d in range(3):
        move = np.zeros(3)
        move[d] = step
        ahead, behind = sdf.sample(points + move), sdf.sample(points - move)
        slope[:, d] = (ahead - behind) / (2 * step)
    norm = np.linalg.norm(slope, axis=1, keepdims=True)
    sharp = norm[:, 0] > 0.1  # the medial axis has no direction
    assert np.abs(found[:, :3] - slope / np.maximum(norm, 1e-9))[smooth & sharp].max() < 1e-3


def test_coulomb() -> None:
    """Contact removes only inward motion and at most mu times as much tangential motion."""
    velocity, wall = random_points(-1, 1, seed=2), random_points(-0.3, 0.3, seed=3)
    normal = random_points(-1, 1, seed=4)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    after = np.zeros_like(velocity)
    run_coulomb(velocity, wall, normal, after, 0.4)
    relative = velocity - wall
    inward = (relative * normal).sum(1)
    tangential = relative - inward[:, None] * normal
    speed = np.linalg.norm(tangential, axis=1)
    keep = np.maximum(0.0, 1 + 0.4 * inward / speed)[:, None]
    exact = np.where((inward < 0)[:, None], wall + keep * tangential, velocity)
    assert np.abs(after - exact).max() < 1e-6


def test_weights() -> None:
    """B-spline weights sum to one and reproduce a particle's position (no first-order error)."""
    dx, origin = 0.003125, np.array([-0.1, -0.1, -0.05])
    grid = rigid.Grid(
        origin=Vec3(*origin), dx=dx, inverse=1 / dx, shape=rigid.Int3(64, 64, 64), table=-1
    )
    points = random_points(-0.04, 0.04, seed=5)
    base, w = np.zeros_like(points), np.zeros((len(points), 3, 3), np.float32)
    run_weights(points, base, w, grid)
    assert np.abs(w.sum(axis=1) - 1).max() < 1e-6
    nodes = base[:, None, :] + np.arange(3)[None, :, None]
    assert np.abs((w * nodes).sum(axis=1) * dx + origin - points).max() < 1e-7


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_occupied_volume_is_that_of_the_fingers(name: str) -> None:
    """The volume that the nodes report as taken sums to the volume of both fingers, within 3 %."""
    tool = PRESETS[name]
    sdf, dx = finger_sdf(tool), 0.003125
    shape = (56, 56, 32)
    origin = np.array([GAP[0], GAP[1], 0.0]) - dx * np.array([28, 28, 6])
    grid = rigid.Grid(
        origin=Vec3(*origin), dx=dx, inverse=1 / dx, shape=rigid.Int3(*shape), table=-1
    )
    total = int(np.prod(shape))
    colliders, free = np.zeros((2 * total, 4), np.float32), np.zeros(2 * total, np.float32)
    run_find(sdf.values.reshape(-1), colliders, free, grid, contact_of(sdf))
    taken = (1.0 - free[total:]).sum() * dx**3
    assert taken == pytest.approx(2 * tool.depth * tool.width * tool.height, rel=0.03)


def test_node_distances_are_those_of_the_fingers() -> None:
    """Every node near a finger knows its distance to each of the two."""
    tool = Tool(name="test", depth=0.012, width=0.02, height=0.03)
    sdf, dx, shape = finger_sdf(tool), 0.003125, (40, 40, 24)
    origin = np.array([GAP[0], GAP[1], 0.0]) - dx * np.array([20, 20, 6])
    grid = rigid.Grid(
        origin=Vec3(*origin), dx=dx, inverse=1 / dx, shape=rigid.Int3(*shape), table=-1
    )
    total = int(np.prod(shape))
    colliders, free = np.zeros((2 * total, 4), np.float32), np.zeros(2 * total, np.float32)
    run_find(sdf.values.reshape(-1), colliders, free, grid, contact_of(sdf))
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    position, _ = finger_poses(Action(position=GAP, yaw=YAW), OPENING)
    for finger, yaw in enumerate((YAW, YAW + np.pi)):
        c, s = np.cos(yaw), np.sin(yaw)
        relative = nodes * dx + origin - position[finger]
        local = relative @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        exact = sdf.sample(local)
        found = colliders[finger * total : (finger + 1) * total, 3]
        near = exact < 0.006
        assert near.sum() > 100
        assert np.abs(found - exact)[near].max() < 1e-7


@pytest.mark.parametrize("dx", [0.0016, 0.003125, 0.00625])
@pytest.mark.parametrize("name", sorted(PRESETS))
def test_nothing_is_lost_where_fingers_are_not_looked_for(name: str, dx: float) -> None:
    """Knowing where the finger lies in its grid changes no volume and no distance below a cell."""
    sdf, cells = finger_sdf(PRESETS[name]), round(0.15 / dx)
    shape = (cells, cells, cells // 2)
    origin = np.array([GAP[0], GAP[1], 0.0]) - dx * np.array([cells // 2, cells // 2, 3])
    grid = rigid.Grid(
        origin=Vec3(*origin), dx=dx, inverse=1 / dx, shape=rigid.Int3(*shape), table=-1
    )
    total, found = int(np.prod(shape)), []
    for beyond in (0.0, MARGIN):
        colliders, free = np.zeros((2 * total, 4), np.float32), np.zeros(2 * total, np.float32)
        contact = contact_of(sdf, beyond=beyond)
        run_find(sdf.values.reshape(-1), colliders, free, grid, contact)
        found.append((colliders, free[total:]))
    (every, volume), (pruned, same) = found
    np.testing.assert_array_equal(volume, same)
    near = every[:, 3] < dx
    assert near.any()
    np.testing.assert_array_equal(every[near], pruned[near])
    skipped = (every != pruned).any(axis=1)
    assert (pruned[skipped, 3] == rigid.FAR).all()
