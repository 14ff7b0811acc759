"""Orthographic view of the workspace for flat drawing, with painter's order and light."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int

__all__ = ["View", "convex_outline", "shaded_faces"]

LIGHT = np.array([-0.45, -0.55, 0.70]) / np.linalg.norm([-0.45, -0.55, 0.70])  # towards the lamp


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Where the viewer stands: far away, at an azimuth about world z and an elevation [rad]."""

    azimuth: float = math.radians(-62.0)
    elevation: float = math.radians(34.0)

    @property
    def axes(self) -> Float64[np.ndarray, "3 3"]:
        """Rows: right, up and towards the viewer, in the world."""
        ca, sa = math.cos(self.azimuth), math.sin(self.azimuth)
        ce, se = math.cos(self.elevation), math.sin(self.elevation)
        return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])

    def project(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float64[np.ndarray, "*batch 2"], Float64[np.ndarray, "*batch"]]:
        """Position on the picture [m] and nearness to the viewer [m] of world points [m]."""
        local = np.asarray(points, float) @ self.axes.T
        return local[..., :2], local[..., 2]


def shaded_faces(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    colour: Float[np.ndarray, " 3"],
    view: View,
) -> tuple[
    Float64[np.ndarray, "seen 3 2"], Float64[np.ndarray, "seen 3"], Float64[np.ndarray, " seen"]
]:
    """Triangles that face the viewer: corners on the picture [m], RGB and nearness [m].

    Diffuse light with a floor, and a little white where the surface turns to the lamp.
    """
    corners = np.asarray(vertices, float)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    facing = (normal @ view.axes[2] > 0) & (length > 0)
    normal = normal[facing] / length[facing, None]
    diffuse = np.clip(normal @ LIGHT, 0, 1)[:, None]
    half = LIGHT + view.axes[2]
    gloss = np.clip(normal @ (half / np.linalg.norm(half)), 0, 1)[:, None] ** 24
    rgb = np.clip(colour * (0.45 + 0.62 * diffuse) + 0.22 * gloss, 0, 1)
    picture, near = view.project(corners[facing])
    return picture, rgb, near.mean(axis=1)


def convex_outline(points: Float[np.ndarray, "points 2"]) -> Float64[np.ndarray, "corners 2"]:
    """Corners of the convex hull, counter-clockwise (Andrew's monotone chain, 1979)."""
    ordered = np.unique(np.asarray(points, float), axis=0)
    if len(ordered) < 3:
        return ordered

    def chain(sequence: Float64[np.ndarray, "points 2"]) -> list[np.ndarray]:
        hull: list[np.ndarray] = []
        for point in sequence:
            while len(hull) > 1:
                (ax, ay), (bx, by) = hull[-1] - hull[-2], point - hull[-1]
                if ax * by - ay * bx > 0:
                    break
                hull.pop()
            hull.append(point)
        return hull[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))
