"""Judges of the topology check that know nothing of how it decides: meshes and persistent homology.

Persistence needs gudhi (GPL), which is a development tool: nothing that ships imports it.
"""

import warnings

import numpy as np

from doughdata.mesh.dual_contouring import DualContouring
from doughschemas import FrameTopology, Particles

__all__ = ["mesh_genus", "persistence_agrees", "persistent_loops"]

LATEST_BIRTH = 1.5  # [spacings]; later loops are of surfaces that only lie near each other
LEAST_PERSISTENCE = 1.0  # [spacings]; loops of noise have at most 0.8, real ones 1.7 and more


def mesh_genus(particles: Particles, frame: FrameTopology, number: int) -> tuple[int, ...]:
    """Genus of the mesh of every component, from Euler's formula V - E + F = 2 - 2 g."""
    meshes = DualContouring().mesh(particles.positions[number], frame, spacing=particles.spacing)
    found = []
    for mesh in meshes.meshes:
        edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        euler = len(np.unique(mesh.faces)) - len(np.unique(edges, axis=0)) + len(mesh.faces)
        found.append(1 - euler // 2)
    return tuple(found)


def persistence_agrees(particles: Particles, frame: FrameTopology, number: int) -> bool:
    """Whether persistent homology of the labelled particles leaves every component's genus.

    Loops are counted with and without the simplices across unmerged contacts: such a contact may
    keep a loop open or be a crease beside a seam. Without contacts both counts are one.
    """
    x = np.asarray(particles.positions[number], np.float64) / particles.spacing
    for label, genus in enumerate(frame.genus):
        members = np.flatnonzero(frame.labels == label)
        inside = (frame.labels[frame.contacts] == label).all(axis=1)
        contacts = np.searchsorted(members, frame.contacts[inside])
        closed = persistent_loops(x[members], contacts[:0])
        opened = persistent_loops(x[members], contacts) if len(contacts) else closed
        if not min(closed, opened) <= genus <= max(closed, opened):
            return False
    return True


def persistent_loops(points: np.ndarray, contacts: np.ndarray) -> int:
    """Long bars of degree 1 of the alpha complex of points (in spacings) without some edges."""
    import gudhi

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tree = gudhi.AlphaComplex(points=points, precision="fast").create_simplex_tree()
    for pair in contacts.tolist():
        if tree.find(pair):
            tree.assign_filtration(pair, np.inf)
    if len(contacts):
        tree.make_filtration_non_decreasing()  # what holds such an edge never comes either
    tree.compute_persistence(homology_coeff_field=2)
    bars = np.sqrt(tree.persistence_intervals_in_dimension(1).reshape(-1, 2))
    long = (bars[:, 0] <= LATEST_BIRTH) & (bars[:, 1] - bars[:, 0] >= LEAST_PERSISTENCE)
    return int(long.sum())
