"""Strategies that draw physically valid records: every one passes `check_scene`."""

from hypothesis import strategies as st

from doughschemas import Action, Body, Material, Scene, Tool

__all__ = ["actions", "bodies", "materials", "scenes", "tools"]


def _within(low: float, high: float) -> st.SearchStrategy[float]:
    # No subnormal numbers: a library built with fast maths may flush them to zero.
    return st.floats(low, high, allow_nan=False, allow_infinity=False, allow_subnormal=False)


def materials() -> st.SearchStrategy[Material]:
    """Dough, clay and what lies between."""
    return st.builds(
        Material,
        young_modulus=_within(1e4, 2e5),
        poisson_ratio=_within(0.2, 0.45),
        density=_within(900.0, 2000.0),
        yield_stress=_within(500.0, 1e4),
    )


def bodies() -> st.SearchStrategy[Body]:
    """One roll or one ring near the origin."""
    place = {
        "position": st.tuples(_within(-0.010, 0.010), _within(-0.010, 0.010)),
        "yaw": _within(-3.2, 3.2),
    }
    roll = st.fixed_dictionaries(
        {"radius": _within(0.008, 0.014), "length": _within(0.03, 0.06), "exponent": _within(2, 8)}
    )
    ring = st.fixed_dictionaries(
        {"ring_radius": _within(0.018, 0.03), "tube_radius": _within(0.006, 0.012)}
    )
    return st.one_of(
        st.builds(Body, shape=st.just("roll"), parameters=roll, **place),
        st.builds(Body, shape=st.just("ring"), parameters=ring, **place),
    )


def tools() -> st.SearchStrategy[Tool]:
    """Box fingers from a blade to a vise."""
    return st.builds(
        Tool,
        name=st.sampled_from(["narrow", "regular", "wide"]),
        depth=_within(0.003, 0.02),
        width=_within(0.003, 0.1),
        friction=_within(0.0, 1.0),
    )


def actions() -> st.SearchStrategy[Action]:
    """Squeezes from a wide opening, so that no finger starts inside a body."""
    return st.builds(
        Action,
        position=st.tuples(_within(-0.01, 0.01), _within(-0.01, 0.01)),
        yaw=_within(-3.2, 3.2),
        opening_start=st.just(0.17),
        opening_end=_within(0.001, 0.03),
        speed=_within(0.02, 0.1),
        hold=_within(0.0, 0.5),
        release=st.booleans(),
    )


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """A valid scene of one body, one or two tools and one to three actions."""
    drawn = draw(st.lists(tools(), min_size=1, max_size=2))
    steps = draw(st.lists(actions(), min_size=1, max_size=3))
    return Scene(
        scene_id=draw(st.text("abcdefgh-0123456789", min_size=1, max_size=12)),
        family="custom",
        region="custom",
        bodies=(draw(bodies()),),
        material=draw(materials()),
        tools=tuple(drawn),
        actions=tuple(steps),
    )
