"""The answer does not depend on the order of the particles or on where the scene lies."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from doughdata.topology.dynamic import DynamicCheck
from doughschemas import Action, Body, Particles, Scene, Tool, ToolPoses

SPACING = 0.002


def state() -> np.ndarray:
    """A ring and a bar on the table."""
    axes = [np.arange(-0.027, 0.060, SPACING), np.arange(-0.027, 0.028, SPACING)]
    grid = np.stack(np.meshgrid(*axes, np.arange(0.001, 0.014, SPACING), indexing="ij"), -1)
    grid = grid.reshape(-1, 3)
    tube = (np.hypot(grid[:, 0], grid[:, 1]) - 0.020) ** 2 + (grid[:, 2] - 0.007) ** 2
    solid = (tube < 0.007**2) | (grid[:, 0] > 0.046)
    return grid[solid] + np.random.default_rng(3).uniform(-0.2, 0.2, (solid.sum(), 3)) * SPACING


def particles_of(x: np.ndarray) -> tuple[Scene, Particles]:
    turn = np.array([[[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]])
    scene = Scene(
        scene_id="lattice",
        family="custom",
        bodies=(Body(shape="roll"),),
        tools=(Tool(name="regular"),),
        actions=(Action(),),
    )
    return scene, Particles(
        positions=x[None].astype(np.float32),
        object_ids=np.zeros(len(x), np.uint8),
        timestamps=np.zeros(1),
        tool_poses=ToolPoses(
            position=np.array([[[0.4, 0.0, 0.0], [-0.4, 0.0, 0.0]]]),
            quaternion=turn,
            opening=np.array([0.8]),
            action=np.zeros(1, np.int32),
        ),
        spacing=SPACING,
    )


@settings(max_examples=6, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-np.pi, np.pi),
    st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    st.booleans(),
)
def test_order_and_pose_do_not_matter(
    seed: int, yaw: float, shift: tuple[float, float], mirrored: bool
) -> None:
    """Permuted, turned, moved and mirrored particles have the same components and genus."""
    x = state()
    order = np.random.default_rng(seed).permutation(len(x))
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = (x * [-1.0 if mirrored else 1.0, 1.0, 1.0]) @ turn.T + [*shift, 0.0]
    (frame,) = DynamicCheck().check(*particles_of(moved[order])).frames
    assert sorted(frame.genus) == [0, 1]
    ring = np.hypot(x[:, 0], x[:, 1]) < 0.03
    labels = np.empty(len(x), np.uint8)
    labels[order] = frame.labels
    assert len(np.unique(labels[ring])) == 1
    assert len(np.unique(labels[~ring])) == 1
