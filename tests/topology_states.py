"""States of dough built from lattices, and the records that a check is given."""

from dataclasses import replace

import numpy as np

from doughdata.scenes.tools import PRESETS
from doughschemas import Action, Body, Particles, Scene, Tool, ToolPoses

SPACING = 0.002


def lattice(low, high, inside=None, *, seed: int = 0) -> np.ndarray:
    axes = [np.arange(a + SPACING / 2, b, SPACING) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    grid = grid if inside is None else grid[inside(grid)]
    return grid + np.random.default_rng(seed).uniform(-0.1, 0.1, grid.shape) * SPACING


def ring(seed: int = 0) -> np.ndarray:
    def inside(g: np.ndarray) -> np.ndarray:
        return (np.hypot(g[:, 0], g[:, 1]) - 0.020) ** 2 + (g[:, 2] - 0.007) ** 2 < 0.007**2

    return lattice((-0.028, -0.028, 0), (0.028, 0.028, 0.014), inside, seed=seed)


def bar(y: float = 0.0) -> np.ndarray:
    return lattice((-0.006, y - 0.015, 0), (0.006, y + 0.015, 0.012))


def block(x: float, seed: int = 0) -> np.ndarray:
    return lattice((x - 0.006, -0.006, 0), (x + 0.006, 0.006, 0.012), seed=seed)


def record(
    *frames: np.ndarray, ids: np.ndarray | None = None, actions: list[int] | None = None
) -> tuple[Scene, Particles]:
    """Particles with fingers far away, so that nothing but the dough decides."""
    count = len(frames)
    position = np.tile([[0.25, 0.0, 0.0], [-0.25, 0.0, 0.0]], (count, 1, 1))
    turn = np.tile([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]], (count, 1, 1))
    scene = Scene(
        scene_id="lattice",
        family="custom",
        bodies=(Body(shape="roll"),),
        tools=(Tool(name="regular"),),
        actions=(Action(),) * (max(actions or [0]) + 1),
    )
    poses = ToolPoses(
        position=position,
        quaternion=turn,
        opening=np.full(count, 0.5),
        action=np.array(actions or [0] * count, np.int32),
    )
    particles = Particles(
        positions=np.asarray(frames, np.float32),
        object_ids=np.zeros(len(frames[0]), np.uint8) if ids is None else ids,
        timestamps=np.arange(count, dtype=float),
        tool_poses=poses,
        spacing=SPACING,
    )
    return scene, particles


def torn_bar() -> tuple[Scene, Particles]:
    """A bar whose halves move 12 mm apart."""
    x = bar()
    far = x + np.where(x[:, 1:2] > 0.004, 0.012, 0.0) * [0.0, 1.0, 0.0]
    return record(x, x, far, far)


def pressed_blocks(gap: float = 0.0) -> tuple[Scene, Particles]:
    """Two blocks that are pushed together to lattice distance plus `gap` [m]."""
    x = np.concatenate([block(-0.012), block(0.012, seed=1)])
    ids = np.repeat([0, 1], len(x) // 2).astype(np.uint8)
    pressed = x - np.where(ids == 1, 0.012 - gap, 0.0)[:, None] * [1.0, 0.0, 0.0]
    return record(x, pressed, ids=ids)


def cut_bar(gap: float) -> tuple[Scene, Particles]:
    """A bar torn apart in one action; in the next its halves come back to lattice + `gap` [m]."""
    x = lattice((-0.006, -0.012, 0), (0.006, 0.012, 0.012))
    half = np.where(x[:, 1:2] > 0.0, 1.0, 0.0) * [0.0, 1.0, 0.0]
    frames = [x, x + 0.012 * half, x + 0.012 * half, x + gap * half, x + gap * half]
    return record(*frames, actions=[0, 0, 1, 1, 1])


def sliced_ring() -> tuple[Scene, Particles]:
    """A ring, and a blade that stands in one side of its tube from key frame 5 on."""
    x = ring()
    slit = (x[:, 0] > 0) & (np.abs(x[:, 1]) < 0.006)
    parted = x + np.where(slit, np.sign(x[:, 1]) * 0.0012, 0.0)[:, None] * [0.0, 1.0, 0.0]
    scene, particles = record(*[x] * 5, *[parted] * 5)
    particles.tool_poses.position[5:, 0] = [0.011, 0.0, 0.0]  # covers the tube at y = 0
    return replace(scene, tools=(PRESETS["narrow"],)), particles


def pinched_link(gap: float) -> tuple[Scene, Particles]:
    """A link with a hole 12 mm wide, whose long walls bow in to a lattice step + `gap` [m]."""

    def inside(g: np.ndarray) -> np.ndarray:
        return (np.abs(g[:, 0]) > 0.006) | (np.abs(g[:, 1]) > 0.024)

    x = lattice((-0.014, -0.032, 0), (0.014, 0.032, 0.012), inside)
    way = (0.006 - gap / 2) * np.interp(np.abs(x[:, 1]), [0.005, 0.020], [1.0, 0.0])
    near = x - np.sign(x[:, :1]) * way[:, None] * [1.0, 0.0, 0.0]
    return record(x, x, near, near, near, near)
