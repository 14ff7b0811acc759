"""Whole scenes: what fingers do to dough, and that it is the same every time."""

import json
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from doughdata.scenes import PRESETS, finger_poses, scene_to_json
from doughdata.scenes.sdf import finger_sdf
from doughdata.sim.mpm import MpmConfig, MpmSimulator, draft, fine, standard
from doughdata.stages import Simulator
from doughschemas import (
    Action,
    BadInputError,
    Body,
    Material,
    Particles,
    Scene,
    SimulationError,
    Tool,
)

CONFIG = MpmConfig(arch="cpu", frames=21)
DX = CONFIG.cells * CONFIG.spacing


def roll(x: float = 0.0, yaw: float = 0.0) -> Body:
    return Body(shape="roll", parameters={"length": 0.040}, position=(x, 0.0), yaw=yaw)


def scene(*bodies: Body, tools=(PRESETS["regular"],), actions) -> Scene:
    return Scene(scene_id="test", family="test", bodies=bodies, tools=tools, actions=actions)


def simulate(scene: Scene, *, config: MpmConfig = CONFIG, seed: int = 0) -> Particles:
    return MpmSimulator(config).simulate(scene, rng=np.random.default_rng(seed))


CUT = scene(roll(), actions=(Action(opening_start=0.030, opening_end=0.001),))
SLICE = replace(CUT, tools=(PRESETS["narrow"],))
PRESS = scene(roll(-0.011), roll(0.011), actions=(Action(opening_start=0.050, opening_end=0.012),))
SMALL = scene(
    Body(shape="roll", parameters={"length": 0.016, "radius": 0.006}),
    actions=(Action(opening_start=0.014, opening_end=0.006, speed=0.05),),
)


@pytest.fixture(scope="module")
def cut() -> Particles:
    return simulate(CUT)


@pytest.fixture(scope="module")
def sliced() -> Particles:
    return simulate(SLICE)


@pytest.fixture(scope="module")
def pressed() -> Particles:
    return simulate(PRESS)


def count_pieces(positions: np.ndarray, *, radius: float = 0.003) -> int:
    """Clusters at a radius [m] that hold more than 2 % of the particles."""
    tree = cKDTree(positions)
    _, labels = connected_components(tree.sparse_distance_matrix(tree, radius))
    return int((np.bincount(labels) > 0.02 * len(positions)).sum())


def finger_distance(positions: np.ndarray, tool: Tool, action: Action, opening: float) -> float:
    """Smallest distance [m] of any particle to either finger."""
    sdf, nearest = finger_sdf(tool), np.inf
    for place, quaternion in zip(*finger_poses(action, opening), strict=True):
        angle = 2 * np.arctan2(quaternion[2], quaternion[3])
        c, s = np.cos(angle), np.sin(angle)
        local = (positions - place) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        nearest = min(nearest, float(sdf.sample(local.astype(np.float64)).min()))
    return nearest


def test_the_record_says_what_happened(cut: Particles) -> None:
    """Key frames are uniform from first to last instant, with the fingers where they are."""
    assert isinstance(MpmSimulator(), Simulator)
    assert cut.positions.dtype == np.float32
    assert cut.positions.shape[0] == len(cut.timestamps) == 21
    assert cut.object_ids.shape == cut.positions.shape[1:2]
    assert cut.timestamps == pytest.approx(np.linspace(0, CUT.duration, 21))
    assert cut.tool_poses.opening == pytest.approx(np.linspace(0.030, 0.001, 21))
    for frame, opening in enumerate(cut.tool_poses.opening):
        place, turn = finger_poses(CUT.actions[0], float(opening))
        assert np.array_equal(cut.tool_poses.position[frame], place)
        assert np.array_equal(cut.tool_poses.quaternion[frame], turn)
    volume = np.pi * 0.010**2 * 0.040
    assert cut.positions.shape[1] * cut.spacing**3 == pytest.approx(volume, rel=0.03)


def test_dough_settles_where_it_was_put(cut: Particles) -> None:
    """At the first key frame the body lies at its place, not more than half a millimetre lower."""
    first = cut.positions[0].astype(np.float64)
    assert np.abs(first.mean(axis=0) - [0, 0, 0.010]).max() < 0.0005


@pytest.mark.parametrize("name", ["cut", "sliced", "pressed"])
def test_no_particle_inside_a_finger_or_the_table(name: str, request) -> None:
    """At every key frame no particle is deeper than 0.25 dx in a finger, or below the table."""
    particles = request.getfixturevalue(name)
    what = {"cut": CUT, "sliced": SLICE, "pressed": PRESS}[name]
    assert particles.positions[..., 2].min() >= 0.0
    for frame, opening in enumerate(particles.tool_poses.opening):
        inside = finger_distance(
            particles.positions[frame], what.tools[0], what.actions[0], float(opening)
        )
        assert inside > -0.25 * DX


@pytest.mark.parametrize("name", ["cut", "pressed"])
def test_volume_is_kept_between_the_fingers(name: str, request) -> None:
    """No neighbourhood ever holds more than 1.3 times the reference density, down to 1 mm."""
    for positions in request.getfixturevalue(name).positions:
        counts = cKDTree(positions).query_ball_point(positions, 0.004, return_length=True)
        assert counts.max() / (4 / 3 * np.pi * 2**3) < 1.3


def test_the_regular_tool_cuts_a_roll(cut: Particles) -> None:
    """A roll squeezed to 1 mm falls into two halves, equal by symmetry to a few per cent."""
    assert count_pieces(cut.positions[10]) == 1
    assert count_pieces(cut.positions[-1]) == 2
    forward = float((cut.positions[-1, :, 1] > 0).mean())
    assert forward == pytest.approx(0.5, abs=0.03)


def test_no_film_stays_between_thin_blades(sliced: Particles) -> None:
    """Between the faces of a 3 mm blade, thinner than a cell, at 1 mm the inner 2 mm hold no more
    dough than fits there, with half as much again for the count of so few particles.
    """
    last, opening = sliced.positions[-1], float(sliced.tool_poses.opening[-1])
    width = PRESETS["narrow"].width - 0.001
    film = (np.abs(last[:, 0]) < opening / 2 + 1e-4) & (np.abs(last[:, 1]) < width / 2)
    room = opening * width * last[:, 2].max()
    assert film.sum() * sliced.spacing**3 < 1.5 * room
    assert abs(float((last[:, 1] > 0).mean()) - 0.5) < 0.03


def test_a_moved_scene_is_the_scene_moved(cut: Particles) -> None:
    """Body and action moved by a fraction of a cell give the same shapes moved."""
    shift = (0.0137, -0.0042)
    moved = simulate(
        scene(
            replace(roll(), position=shift),
            actions=(replace(CUT.actions[0], position=shift),),
        )
    )
    back = moved.positions - np.array([*shift, 0.0])
    assert np.sqrt(((back - cut.positions) ** 2).mean(axis=(1, 2))).max() < 2e-5


def test_two_rolls_merge(pressed: Particles) -> None:
    """Two rolls 2 mm apart, squeezed to 12 mm, become one cluster at 1.5 spacings."""
    assert count_pieces(pressed.positions[0]) == 2
    assert count_pieces(pressed.positions[-1]) == 1
    assert set(np.unique(pressed.object_ids)) == {0, 1}


def test_a_turned_scene_is_the_scene_turned(cut: Particles) -> None:
    """Body and action turned by 90 degrees give the same shapes turned, to a few micrometres."""
    turned = simulate(scene(roll(yaw=np.pi / 2), actions=(replace(CUT.actions[0], yaw=np.pi / 2),)))
    back = turned.positions @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    assert np.abs(back - cut.positions)[:-3].max() < 5e-6
    assert np.sqrt(((back - cut.positions) ** 2).mean(axis=(1, 2))).max() < 1e-5


def test_sleeping_changes_nothing_that_matters() -> None:
    """Dough that rests while the fingers are far ends within 0.1 mm of dough kept awake."""
    far = replace(SMALL, actions=(replace(SMALL.actions[0], opening_start=0.060),))
    asleep = simulate(far).positions
    awake = simulate(far, config=replace(CONFIG, rest=0.0)).positions
    assert np.array_equal(asleep[5], asleep[6])
    assert np.linalg.norm(asleep - awake, axis=2).max() < 1e-4


def test_fingers_release_and_return() -> None:
    """After a release dough stays put; a second action uses its own tool and pose."""
    wide = Tool(name="paddle", depth=0.004, width=0.030, height=0.030)
    squeeze = replace(SMALL.actions[0], hold=0.04, release=True)
    again = Action(tool=1, yaw=np.pi / 2, opening_start=0.030, opening_end=0.012, speed=0.05)
    double = replace(SMALL, tools=(*SMALL.tools, wide), actions=(squeeze, again))
    particles = simulate(double, config=replace(CONFIG, frames=41))
    actions, opening = particles.tool_poses.action, particles.tool_poses.opening
    assert list(actions) == sorted(actions)
    assert set(actions) == {0, 1}
    assert opening[actions == 0].min() == pytest.approx(0.006, abs=1e-9)
    assert opening[-1] == pytest.approx(0.012)
    last = particles.positions[-1]
    assert finger_distance(last, wide, again, 0.012) > -0.25 * DX
    assert np.ptp(last[:, 1]) < 0.012 + 1e-5
    assert np.ptp(particles.positions[0, :, 1]) > 0.014


def test_a_mesh_finger_acts_like_the_box_it_is(tmp_path: Path) -> None:
    """A box finger read from a mesh file moves dough as the box made of numbers does."""
    tool = PRESETS["regular"]
    box = trimesh.creation.box(extents=[tool.depth, tool.width, tool.height])
    box.apply_translation([tool.depth / 2, 0, tool.height / 2])
    box.export(tmp_path / "box.stl")
    mesh = Tool(name="mesh", mesh=str(tmp_path / "box.stl"), friction=tool.friction)
    first, second = simulate(SMALL), simulate(replace(SMALL, tools=(mesh,)))
    assert np.abs(first.positions - second.positions).max() < 1e-4


def digest(particles: Particles) -> str:
    return sha256(particles.positions.tobytes()).hexdigest()


def test_the_same_bytes_every_time(cut: Particles) -> None:
    """A scene gives the same bytes after other scenes, on other grids, in the same process."""
    first = simulate(SMALL)
    simulate(SMALL, config=replace(CONFIG, spacing=0.003))
    assert digest(simulate(SMALL)) == digest(first)
    assert digest(simulate(SMALL, seed=1)) != digest(first)
    assert digest(simulate(CUT)) == digest(cut)


def test_the_same_bytes_in_another_process() -> None:
    """A fresh process gives the bytes of this one."""
    code = (
        "import numpy as np; from doughdata.scenes import scene_from_json\n"
        "import json, sys; from hashlib import sha256\n"
        "from doughdata.sim.mpm import MpmConfig, MpmSimulator\n"
        "scene = scene_from_json(json.loads(sys.argv[1]))\n"
        "sim = MpmSimulator(MpmConfig(arch='cpu', frames=21))\n"
        "out = sim.simulate(scene, rng=np.random.default_rng(0))\n"
        "print(sha256(out.positions.tobytes()).hexdigest())\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(scene_to_json(SMALL))],
        capture_output=True,
        text=True,
        check=True,
    )
    # Nothing else on stdout: a banner would break `--json`.
    assert done.stdout == digest(simulate(SMALL)) + "\n"


@pytest.mark.parametrize(
    ("material", "speed"),
    [
        (Material(young_modulus=1e6, yield_stress=2e4), 0.05),
        (Material(young_modulus=1e3, yield_stress=50.0), 0.05),
        (Material(yield_stress=1e9), 0.05),
        (Material(yield_stress=10.0), 0.05),
        (Material(poisson_ratio=0.48), 0.05),
        (Material(poisson_ratio=0.0), 0.05),
        (Material(), 0.3),
    ],
)
def test_the_corners_of_the_limits_are_stable(material: Material, speed: float) -> None:
    """The stiffest, softest, most elastic and most fluid dough and the fastest finger that a scene
    may ask for run to the end, keep their volume and leave the fingers and the table free.
    """
    # The most fluid dough spreads while it settles: fingers begin well beside it.
    action = replace(SMALL.actions[0], opening_start=0.06, opening_end=0.002, speed=speed)
    particles = simulate(replace(SMALL, material=material, actions=(action,)))
    last = particles.positions[-1]
    assert np.isfinite(last).all()
    assert last[:, 2].min() >= 0.0
    assert finger_distance(last, SMALL.tools[0], action, 0.002) > -0.25 * DX
    counts = cKDTree(last).query_ball_point(last, 0.004, return_length=True)
    assert counts.max() / (4 / 3 * np.pi * 2**3) < 1.5


def test_dough_outside_the_domain_is_named() -> None:
    """Dough beyond the domain is an error that names the scene and the axis, not a crash."""
    off = replace(SMALL, bodies=(replace(SMALL.bodies[0], position=(0.0, -0.115)),))
    with pytest.raises(SimulationError, match=r"scene 'test': dough left the domain along y"):
        simulate(off, config=replace(CONFIG, domain=0.1))


def test_presets_and_limits() -> None:
    """Presets differ by their spacing alone, and a number outside its limits is refused by name."""
    assert [f().spacing for f in (draft, standard, fine)] == [0.002, 0.0015, 0.001]
    assert replace(fine(), spacing=0.002) == draft() == MpmConfig()
    with pytest.raises(BadInputError, match=r"cfl must be within 0\.01\.\.0\.9, got 2"):
        MpmConfig(cfl=2.0)
    with pytest.raises(BadInputError, match="arch"):
        simulate(SMALL, config=replace(CONFIG, arch="abacus"))
