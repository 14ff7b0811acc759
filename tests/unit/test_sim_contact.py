"""Rigid fingers and the table: where the face is, Coulomb's law, what is never inside."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from doughdata.scenes import PRESETS, finger_poses
from doughdata.scenes.doughnut import Doughnut
from doughdata.scenes.rolls import Rolls
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim.mpm import MpmConfig, MpmSimulator
from doughdata.sim.solver import Physics, Solver, Squeeze
from doughschemas import Action, Body, Material, Scene, Tool

SPACING, DX = 0.002, 0.003125
SIDE = 8  # particles a side of the block
PLATE = Tool(name="plate", depth=0.010, width=0.040, height=0.050)
ELASTIC = Material(yield_stress=1e9)
MIDDLE = np.array([0.0, 0.0, 0.025])  # of the block, half way up the plate


def closing_axis(yaw: float) -> np.ndarray:
    return np.array([np.cos(yaw), np.sin(yaw), 0.0])


def held_block(yaw: float, *, material: Material = ELASTIC) -> Solver:
    """A block of 16 mm in the air, turned with the fingers; particle layers along their axis."""
    grid = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    positions = ((grid + 0.5 - SIDE / 2) * SPACING) @ turn + MIDDLE
    physics = Physics(
        material=material,
        spacing=SPACING,
        dx=DX,
        cfl=0.4,
        density_cap=1.15,  # above the noise of the density: contact alone moves dough here
        gravity=0.0,
        low=(-0.03, -0.03, 0.0),
        high=(0.03, 0.03, 0.05),
        table_friction=None,
    )
    return Solver(positions, physics, middle=(0.0, 0.0))


def plates(yaw: float, opening: float, rate: float = 0.0, friction: float = 0.0) -> Squeeze:
    return Squeeze(
        sdf=finger_sdf(PLATE),
        position=(0.0, 0.0),
        yaw=yaw,
        opening=opening,
        rate=rate,
        friction=friction,
    )


def close(solver: Solver, yaw: float, end: float, *, start: float = 0.020) -> None:
    """Press without friction at 50 mm/s a finger, then wait until the block has rung out."""
    solver.advance((start - end) / 0.1, squeeze=plates(yaw, start, -0.1))
    solver.advance(0.06, squeeze=plates(yaw, end))


def layers(solver: Solver, yaw: float) -> np.ndarray:
    """Mean place [m] of every layer of particles along the closing axis."""
    along = solver.x.astype(np.float64) @ closing_axis(yaw)
    return along.reshape(SIDE, -1).mean(axis=1)


def normal_force(solver: Solver, yaw: float) -> float:
    """Force [N] through the middle of an elastic block: mean stress there times its section."""
    m, n = solver.physics.material, closing_axis(yaw)
    shear = m.young_modulus / (2 * (1 + m.poisson_ratio))
    bulk = m.young_modulus / (3 * (1 - 2 * m.poisson_ratio))
    b = solver.b.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    values, axes = np.linalg.eigh(b)
    logs = 0.5 * np.log(values)
    trace = logs.sum(1, keepdims=True)
    tau = np.einsum("nij,nj,nkj->nik", axes, 2 * shear * (logs - trace / 3) + bulk * trace, axes)
    along = np.einsum("nij,i,j->n", tau, n, n).reshape(SIDE, -1)
    place = layers(solver, yaw)
    middle = slice(SIDE // 2 - 2, SIDE // 2 + 2)
    # Kirchhoff stress times reference volume over the present length: Cauchy stress times section.
    length = (place[middle][-1] - place[middle][0]) * 4 / 3
    return -float(along[middle].sum()) * SPACING**3 / length


@pytest.mark.parametrize("yaw", [0.0, np.pi / 6])
def test_the_face_is_where_it_is_drawn(yaw: float) -> None:
    """Over a cell of sub-cell offsets dough ends within 0.25 cells of the finger's face."""
    for offset in np.linspace(0.0, 0.9, 10) * DX:
        half = 0.0076 - offset / 2
        solver = held_block(yaw, material=Material())
        close(solver, yaw, 2 * half)
        place = layers(solver, yaw)
        right = place[-1] + (place[-1] - place[-2]) / 2
        left = place[0] - (place[1] - place[0]) / 2
        assert abs(right - half) < 0.25 * DX
        assert abs(left + half) < 0.25 * DX


@pytest.mark.parametrize("yaw", [0.0, np.pi / 6])
def test_force_begins_at_the_face(yaw: float) -> None:
    """The force of frictionless plates on an elastic block is E A log(L / opening), and
    so tells the place of their faces to 0.25 cells.
    """
    length = SIDE * SPACING
    for opening in np.array([1.0, 0.99, 0.98, 0.97]) * length:
        solver = held_block(yaw)
        close(solver, yaw, opening, start=1.1 * length)
        strain = normal_force(solver, yaw) / (ELASTIC.young_modulus * length**2)
        assert abs(strain + np.log(opening / length)) * length / 2 < 0.25 * DX


def slow_down(yaw: float, friction: float) -> tuple[float, float]:
    """Deceleration [m/s2] of a block that slides between two fingers, and 2 mu N / m."""
    solver = held_block(yaw)
    close(solver, yaw, 0.0152)
    along = np.cross([0.0, 0.0, 1.0], closing_axis(yaw))
    solver.v[:] += along.astype(np.float32)
    mass = len(solver.x) * ELASTIC.density * SPACING**3
    start, force, seconds = float((solver.v @ along).mean()), [], 0.006
    for _ in range(6):
        solver.advance(seconds / 6, squeeze=plates(yaw, 0.0152, friction=friction))
        force.append(normal_force(solver, yaw))
    end = float((solver.v @ along).mean())
    assert end > 0.3  # it still slides
    return (start - end) / seconds, 2 * friction * float(np.mean(force)) / mass


@pytest.mark.parametrize("yaw", [0.0, np.pi / 6])
def test_sliding_between_fingers_obeys_coulomb(yaw: float) -> None:
    """A sliding block slows down in proportion to mu, to 3 %, by 2 mu N / m, to the 10 % with
    which the stress in 8 layers tells N; without friction not at all.
    """
    (none, _), (half, half_law), (full, full_law) = (slow_down(yaw, f) for f in (0.0, 0.05, 0.1))
    assert abs(none) < 1e-3
    assert full == pytest.approx(2 * half, rel=0.03)
    assert [half, full] == pytest.approx([half_law, full_law], rel=0.1)


def test_friction_holds_what_it_can() -> None:
    """With much friction a pressed block does not slide: it swings about the place where it was."""
    solver = held_block(0.0)
    close(solver, 0.0, 0.0152)
    before = layers(solver, 0.0), solver.x[:, 1].astype(np.float64)
    solver.v[:, 1] += 0.2
    solver.advance(0.1, squeeze=plates(0.0, 0.0152, friction=5.0))
    moved = (solver.x[:, 1] - before[1]).reshape(SIDE, -1).mean(axis=1)
    assert np.abs(moved[[0, -1]]).max() < 0.5 * SPACING  # 20 mm if it slid
    assert np.abs(layers(solver, 0.0) - before[0]).max() < 0.1 * DX


@pytest.mark.parametrize("friction", [0.0, 5.0])
def test_receding_fingers_do_not_pull(friction: float) -> None:
    """Fingers that leave a block they touch leave it at rest, whatever their friction."""
    solver = held_block(0.0)
    before, opening = solver.positions, SIDE * SPACING
    solver.advance(0.05, squeeze=plates(0.0, opening, 0.1, friction))
    assert np.abs(solver.x - before).max() < 1e-6
    assert np.abs(solver.v).max() < 1e-4


@pytest.mark.parametrize("material", [ELASTIC, Material()])
@pytest.mark.parametrize("height", [0.0, 0.3, 0.6, 1.0])
def test_dropped_dough_lands_on_the_table(material: Material, height: float) -> None:
    """Dropped from up to one cell, a block comes to rest with its lower face within 0.25 cells of
    the table: the grid must not stop it in the air.
    """
    grid = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    positions = (grid + 0.5 - [SIDE / 2, SIDE / 2, 0.0]) * SPACING + [0.0, 0.0, height * DX]
    physics = replace(held_block(0.0).physics, material=material, gravity=9.81, table_friction=0.5)
    solver = Solver(positions, physics)
    solver.advance(0.2)
    low, above = (solver.x[grid[:, 2] == k, 2].mean(dtype=np.float64) for k in (0, 1))
    assert abs(low - (above - low) / 2) < 0.25 * DX


@pytest.mark.parametrize("yaw", [0.0, np.pi / 6])
def test_nothing_happens_before_contact(yaw: float) -> None:
    """Fingers that stop a quarter of a cell from dough, or press half a cell of air out of the
    way, leave it alone.
    """
    solver = held_block(yaw)
    before, gap = solver.positions, SIDE * SPACING + 2 * 0.25 * DX
    solver.advance(0.5 * DX / 0.05, squeeze=plates(yaw, gap + DX, -0.1))
    assert np.abs(solver.x - before).max() < 1e-6


def roll_scene(tool: Tool, yaw: float, *, end: float = 0.001) -> Scene:
    """A short roll, cut in its middle by fingers at a yaw."""
    action = Action(opening_start=0.030, opening_end=end, yaw=yaw, speed=0.05)
    body = Body(shape="roll", parameters={"length": 0.024, "radius": 0.008})
    return Scene(scene_id="cut", family="test", bodies=(body,), tools=(tool,), actions=(action,))


def depths(scene: Scene, *, frames: int) -> tuple[float, float]:
    """Smallest distance [m] of any particle to a finger and to the table, over key frames."""
    config = MpmConfig(arch="cpu", frames=frames)
    run = MpmSimulator(config).simulate(scene, rng=np.random.default_rng(0))
    nearest = np.inf
    for frame, opening in enumerate(run.tool_poses.opening):
        index = int(run.tool_poses.action[frame])
        action = scene.actions[index]
        sdf = finger_sdf(scene.tools[action.tool])
        for place, quaternion in zip(*finger_poses(action, float(opening)), strict=True):
            angle = 2 * np.arctan2(quaternion[2], quaternion[3])
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            local = (run.positions[frame].astype(np.float64) - place) @ turn
            nearest = min(nearest, float(sdf.sample(local).min()))
    return nearest, float(run.positions[..., 2].min())


def mesh_tool(kind: str, folder: Path) -> Tool:
    """A finger with a curved face (a cylinder), or one that narrows upwards (a cut cone)."""
    if kind == "cylinder":
        mesh = trimesh.creation.cylinder(radius=0.006, height=0.050, sections=48)
        mesh.apply_translation([0.006, 0.0, 0.025])
    else:
        mesh = trimesh.creation.box(extents=[0.012, 0.012, 0.050])
        mesh.apply_translation([0.006, 0.0, 0.025])
        narrow = 1 - 0.5 * mesh.vertices[:, 2] / 0.050
        mesh.vertices[:, 1] *= narrow
        mesh.vertices[:, 0] = 0.006 + (mesh.vertices[:, 0] - 0.006) * narrow
    path = folder / f"{kind}.stl"
    mesh.export(path)
    return Tool(name=kind, mesh=str(path))


@pytest.mark.parametrize("yaw", [0.0, np.pi / 6])
@pytest.mark.parametrize("tool", ["narrow", "regular", "wide", "cylinder", "tapered"])
def test_nothing_enters_fingers_or_table(tool: str, yaw: float, tmp_path: Path) -> None:
    """Box, round and tapered fingers, straight and oblique, down to 1 mm: at every key frame no
    particle is deeper in a finger than 0.25 cells, or below the table.
    """
    finger = PRESETS[tool] if tool in PRESETS else mesh_tool(tool, tmp_path)
    inside, below = depths(roll_scene(finger, yaw), frames=15)
    assert inside > -0.25 * DX
    assert below >= 0.0


@pytest.mark.slow
@pytest.mark.parametrize("tool", sorted(PRESETS))
@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("family", [Rolls, Doughnut])
def test_nothing_enters_the_fingers_of_sampled_scenes(family, number: int, tool: str) -> None:
    """The same in scenes drawn from both families, with every tool, set down clear of the dough.

    A vise stops at 8 mm: closed to a film, it would press the dough out of the workspace.
    """
    scene = family().sample(seed=7, number=number, split="train")
    (action,) = scene.actions
    end = max(action.opening_end, 0.008) if tool == "wide" else action.opening_end
    action = replace(action, opening_start=0.16, opening_end=end)
    scene = replace(scene, tools=(PRESETS[tool],), actions=(action,))
    inside, below = depths(scene, frames=75)
    assert inside > -0.25 * DX
    assert below >= 0.0


@pytest.mark.parametrize("shift", [0.0, 0.3 * DX, 0.6 * DX])
@pytest.mark.parametrize("yaw", [0.0, np.pi / 12, np.pi / 6, np.pi / 4])
def test_density_between_regular_fingers(yaw: float, shift: float) -> None:
    """At 1 mm, at any yaw and sub-cell offset of the dough, no ball of two spacings holds more
    than 1.3 times its share of particles.
    """
    scene = roll_scene(PRESETS["regular"], yaw)
    body = replace(scene.bodies[0], position=(shift, 0.5 * shift))
    config = MpmConfig(arch="cpu", frames=2)
    run = MpmSimulator(config).simulate(
        replace(scene, bodies=(body,)), rng=np.random.default_rng(1)
    )
    last = run.positions[-1]
    counts = cKDTree(last).query_ball_point(last, 2 * SPACING, return_length=True)
    assert counts.max() / (4 / 3 * np.pi * 2**3) < 1.3
