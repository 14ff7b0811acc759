"""The families beyond the paper: shapes, topology of their bodies, reach of their scenes."""

import math

import numpy as np
import pytest
from skimage.measure import euler_number

from doughdata.scenes import load_family, shape_of
from doughdata.sim.mpm import MpmConfig, MpmSimulator
from doughschemas import Action, Body, Scene, SceneError, Tool

FAMILIES = ("rolls", "doughnut", "roll", "ball", "pretzel")


def filled(body: Body, h: float) -> np.ndarray:
    solid = shape_of(body)
    low, high = solid.bounds()
    axes = [np.arange(a - 1.5 * h, b + 2 * h, h) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    return solid.contains(points.reshape(-1, 3)).reshape(points.shape[:3])


def test_a_balls_volume_is_that_of_an_ellipsoid() -> None:
    """Counting grid points gives 4/3 pi a a c within 1 %."""
    body = Body(shape="ball", parameters={"radius": 0.014, "flatness": 0.7})
    expected = 4 / 3 * math.pi * 0.014**3 * 0.7
    assert filled(body, 0.0005).sum() * 0.0005**3 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("holes", [2, 3, 4])
def test_a_pretzel_has_as_many_handles_as_holes(holes: int) -> None:
    """The Euler number of the body is 1 - genus: one piece with `holes` handles, no cavity."""
    body = Body(shape="pretzel", parameters={"holes": holes})
    assert euler_number(filled(body, 0.001), connectivity=3) == 1 - holes


@pytest.mark.parametrize("holes", [1, 2.5, True, "2"])
def test_a_pretzel_without_whole_holes_is_refused(holes: object) -> None:
    """Holes are counted: two to six."""
    with pytest.raises(SceneError, match="pretzel holes"):
        shape_of(Body(shape="pretzel", parameters={"holes": holes}))  # type: ignore[dict-item]


@pytest.mark.parametrize("family", ["ball", "doughnut", "pretzel", "roll", "rolls"])
def test_sampled_bodies_have_the_topology_of_their_family(family: str) -> None:
    """Components minus handles of all bodies together is the Euler number of a sampled scene."""
    for number in range(12):
        bodies = load_family(family).sample(seed=5, number=number, split="train").bodies
        handles = sum(
            {"ring": 1}.get(body.shape, int(body.parameters.get("holes", 0))) for body in bodies
        )
        found = sum(euler_number(filled(body, 0.001), connectivity=3) for body in bodies)
        assert found == len(bodies) - handles


@pytest.mark.parametrize("family", FAMILIES)
def test_scenes_of_a_family_differ_in_every_drawn_quantity(family: str) -> None:
    """Tools, yaws, positions and openings are all drawn anew."""
    scenes = [load_family(family).sample(seed=0, number=k, split="train") for k in range(30)]
    assert len({scene.tools[0].name for scene in scenes}) == 3
    for quantity in ("yaw", "position", "opening_end"):
        assert len({getattr(scene.actions[0], quantity) for scene in scenes}) > 25


def test_pretzels_keep_their_handles_while_they_settle() -> None:
    """After settling, the dough within 1.25 spacings of a particle still has all its handles."""
    for number in (0, 1):
        scene = load_family("pretzel").sample(seed=1, number=number, split="train")
        far = Scene(
            scene_id="x",
            family="custom",
            bodies=scene.bodies,
            tools=(Tool(name="far", width=0.004),),
            actions=(Action(position=(0.1, 0.1), opening_start=0.01, opening_end=0.009),),
        )
        config = MpmConfig(spacing=0.002, frames=2, settle=0.3)
        x = MpmSimulator(config).simulate(far, rng=np.random.default_rng(0)).positions[-1]
        assert euler_number(near(x, 1.25 * config.spacing), connectivity=3) == 1 - int(
            scene.bodies[0].parameters["holes"]
        )


def near(x: np.ndarray, radius: float) -> np.ndarray:
    from scipy.spatial import cKDTree

    h = radius / 3
    axes = [
        np.arange(a - 2 * radius, b + 2 * radius, h)
        for a, b in zip(x.min(0), x.max(0), strict=True)
    ]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    distance, _ = cKDTree(x).query(nodes.reshape(-1, 3), distance_upper_bound=radius)
    return np.isfinite(distance).reshape(nodes.shape[:3])
