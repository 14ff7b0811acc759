"""Genus and scene graph of every component in every key frame, from its solid."""

from dataclasses import dataclass

import numpy as np
from doughschemas import SceneGraph
from jaxtyping import Float64, Int64, UInt8
from scipy.spatial import cKDTree

from doughdata.topology.skeletons import Skeleton, cycle_rank, skeleton_of
from doughdata.topology.solids import solid_genus, solid_of
from doughdata.topology.tracking import count_labels

__all__ = ["Shape", "ShapeReader", "scene_graph"]

STILL = 0.1  # [spacings]; a component that moved less than this keeps its shape
RETHIN = 2.0  # [spacings]; a component that moved more than this gets a new skeleton
NODE_LENGTH = 0.008  # [m], between nodes of a graph
SPUR = 0.008  # [m], branches that end sooner are no branches


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Genus and graph of one component in one key frame."""

    members: Int64[np.ndarray, " members"]  # particles
    read_at: Float64[np.ndarray, "members 3"]  # [m], when the genus was read
    thinned_at: Float64[np.ndarray, "members 3"]  # [m], when the skeleton was made
    walls: Int64[np.ndarray, "walls 2"]
    genus: int
    skeleton: Skeleton
    node: Int64[np.ndarray, " members"]  # nearest node of each particle
    sure: bool  # the genus is the same at the other closing radii, and the graph agrees


class ShapeReader:
    """Reads shapes, and keeps those of components that have hardly changed."""

    def __init__(self, spacing: float, radii: tuple[float, ...]) -> None:
        self.spacing, self.radii = spacing, radii
        self.known: dict[int, Shape] = {}

    def read(
        self,
        positions: Float64[np.ndarray, "particles 3"],
        labels: UInt8[np.ndarray, " particles"],
        walls: Int64[np.ndarray, "walls 2"],
    ) -> list[Shape]:
        """Shapes of the components of one key frame, in the order of the labels."""
        shapes = []
        for k in range(count_labels(labels)):
            members = np.flatnonzero(labels == k)
            own = walls[(labels[walls] == k).all(axis=1)]
            shapes.append(self._shape(positions[members], members, own, self.known.get(k)))
        self.known = dict(enumerate(shapes))
        return shapes

    def _shape(
        self,
        x: Float64[np.ndarray, "members 3"],
        members: Int64[np.ndarray, " members"],
        walls: Int64[np.ndarray, "walls 2"],
        before: Shape | None,
    ) -> Shape:
        same = before is not None and np.array_equal(before.members, members)
        if before is not None and same and len(walls) == len(before.walls):
            if np.abs(x - before.read_at).max() < STILL * self.spacing:
                return before
        local = np.searchsorted(members, walls)
        solid = solid_of(x, self.spacing, radius=self.radii[0], walls=local)
        genus = solid_genus(solid.inside)
        sure = True
        if before is not None and same and genus == before.genus:
            if np.abs(x - before.thinned_at).max() < RETHIN * self.spacing:
                return Shape(
                    members=members,
                    read_at=x,
                    thinned_at=before.thinned_at,
                    walls=walls,
                    genus=genus,
                    skeleton=before.skeleton,
                    node=before.node,
                    sure=sure,
                )
        skeleton = skeleton_of(solid, length=NODE_LENGTH, spur=SPUR)
        sure &= cycle_rank(len(skeleton.positions), skeleton.edges) == genus
        return Shape(
            members=members,
            read_at=x,
            thinned_at=x,
            walls=walls,
            genus=genus,
            skeleton=skeleton,
            node=cKDTree(skeleton.positions).query(x)[1],
            sure=sure,
        )


def scene_graph(
    positions: Float64[np.ndarray, "particles 3"], shapes: list[Shape]
) -> SceneGraph:
    """Join the skeletons of all components; a node moves with the particles it stands for."""
    nodes, components, particles, edges, base = [], [], [], [], 0
    for k, shape in enumerate(shapes):
        number = len(shape.skeleton.positions)
        counts = np.bincount(shape.node, minlength=number)
        moved = positions[shape.members] - shape.thinned_at
        shift = np.zeros((number, 3))
        np.add.at(shift, shape.node, moved)
        shift /= np.maximum(counts, 1)[:, None]
        nodes.append(shape.skeleton.positions + shift)
        components.append(np.full(number, k, np.uint8))
        particles.append(counts.astype(np.int32))
        edges.append(shape.skeleton.edges + base)
        base += number
    return SceneGraph(
        positions=np.concatenate(nodes).astype(np.float32),
        components=np.concatenate(components),
        particles=np.concatenate(particles),
        edges=np.concatenate(edges).astype(np.int32),
    )
