"""Meshes of a whole scene: where nothing has moved, a key frame keeps those of an earlier one."""

import numpy as np

from doughdata.stages import Mesher
from doughschemas import ComponentMeshes, Particles, Topology

__all__ = ["mesh_frames"]

STILL = 0.02  # [spacings]; a thirtieth of a mesh cell


def mesh_frames(mesher: Mesher, particles: Particles, topology: Topology) -> list[ComponentMeshes]:
    """Meshes of every key frame, in order.

    A key frame is meshed anew unless its record is that of the last one meshed and no particle is
    further than `STILL` from where it was then.

    Raises:
        BadInputError: positions of a component that are not finite.
    """
    found: list[ComponentMeshes] = []
    meshed = 0
    for frame, (positions, own) in enumerate(
        zip(particles.positions, topology.frames, strict=True)
    ):
        if found and _still(particles, topology, meshed, frame):
            found.append(found[-1])
        else:
            found.append(mesher.mesh(positions, own, spacing=particles.spacing))
            meshed = frame
    return found


def _still(particles: Particles, topology: Topology, before: int, now: int) -> bool:
    """Whether nothing that a mesher is given has changed between two key frames."""
    was, own = topology.frames[before], topology.frames[now]
    if was.genus != own.genus or not np.array_equal(was.labels, own.labels):
        return False
    if not np.array_equal(was.contacts, own.contacts):
        return False
    moved = np.abs(particles.positions[now] - particles.positions[before]).max()
    return bool(moved < STILL * particles.spacing)
