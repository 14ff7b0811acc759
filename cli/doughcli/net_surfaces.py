"""Between labels on a lattice and surfaces."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int64, Integer

from doughdata.registry import require_package
from doughschemas import NO_COMPONENT, ComponentMesh

__all__ = ["closed_surface", "from_above", "voxels"]

SMOOTHING = 0.8  # nodes; a surface of whole nodes has steps


def closed_surface(
    mask: Bool[np.ndarray, "nx ny nz"], lattice: Any, *, stride: int = 2
) -> tuple[Float32[np.ndarray, "vertices 3"], Int64[np.ndarray, "faces 3"]]:
    """Surface [m] of the marked nodes of a `doughnet.lattice.Lattice`; empty if there is none."""
    ndimage = require_package("scipy.ndimage", extra="train")
    measure = require_package("skimage.measure", extra="sim")
    field = np.pad(mask[::stride, ::stride, ::stride].astype(np.float32), 2)
    field = ndimage.gaussian_filter(field, SMOOTHING)
    if field.max() <= 0.5:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64)
    vertices, faces, _, _ = measure.marching_cubes(field, 0.5)
    vertices = (vertices - 2) * stride * lattice.spacing + lattice.origin
    return vertices.astype(np.float32), faces[:, ::-1].astype(np.int64)


def from_above(labels: Integer[np.ndarray, "nx ny nz"], count: int) -> Integer[np.ndarray, "nx ny"]:
    """The topmost component over every node of the table, -1 where there is none."""
    solid = (labels >= 0) & (labels < count)
    top = labels.shape[2] - 1 - solid[:, :, ::-1].argmax(axis=2)
    seen = np.take_along_axis(labels, top[..., None], 2)[..., 0].astype(int)
    return np.where(solid.any(axis=2), seen, -1)


def voxels(meshes: Sequence[ComponentMesh], lattice: Any) -> Int64[np.ndarray, "nx ny nz"]:
    """The mesh that each node of a lattice lies in, by its number, else NO_COMPONENT."""
    geometry = require_package("open3d", extra="render").t.geometry
    labels = np.full(lattice.shape, NO_COMPONENT, np.int64)
    for number, mesh in enumerate(meshes):
        scene = geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(
            np.ascontiguousarray(mesh.vertices, np.float32),
            np.ascontiguousarray(mesh.faces, np.uint32),
        )
        corner = (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
        low, high = ((c - lattice.origin) / lattice.spacing for c in corner)
        low = np.clip(np.floor(low), 0, lattice.shape).astype(int)
        high = np.clip(np.ceil(high) + 1, 0, lattice.shape).astype(int)
        axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        points = (lattice.origin + nodes * lattice.spacing).astype(np.float32)
        inside = scene.compute_occupancy(points, nthreads=1, nsamples=3).numpy() > 0.5
        labels[tuple(nodes[inside].T)] = number
    return labels
