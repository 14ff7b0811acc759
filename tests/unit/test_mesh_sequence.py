"""Meshes of a scene: made again when anything that they show has changed, and only then."""

from dataclasses import replace

import numpy as np
import pytest

from doughdata.mesh.dual_contouring import DualContouring
from doughdata.mesh.sequence import mesh_frames
from doughschemas import ComponentMeshes, FrameTopology, Particles, SceneGraph, Topology
from tests.topology_states import SPACING, bar, record


class Counting(DualContouring):
    """The real mesher, and how often it was asked."""

    asked = 0

    def mesh(self, *args, **settings) -> ComponentMeshes:
        """Mesh one key frame."""
        self.asked += 1
        return super().mesh(*args, **settings)


def one_piece(count: int) -> FrameTopology:
    return FrameTopology(
        labels=np.zeros(count, np.uint8),
        genus=(0,),
        graph=SceneGraph(
            positions=np.zeros((1, 3), np.float32),
            components=np.zeros(1, np.uint8),
            particles=np.array([count], np.int32),
            edges=np.zeros((0, 2), np.int32),
        ),
        contacts=np.zeros((0, 2), np.int32),
    )


def scene_of(*shifts: float) -> tuple[Particles, Topology]:
    """A bar shifted by so many spacings in each key frame, always one piece."""
    x = bar()
    _, particles = record(*(x + shift * SPACING for shift in shifts))
    none = (np.zeros((0, 2), np.int32),) * len(shifts)
    topology = Topology(
        frames=(one_piece(len(x)),) * len(shifts),
        events=(),
        static_num_components=np.ones(len(shifts), np.int32),
        static_genus=((0,),) * len(shifts),
        bonds_made=none,
        bonds_broken=none,
    )
    return particles, topology


def test_what_creeps_is_meshed_when_it_has_moved() -> None:
    """Steps of a hundredth of a spacing: every second key frame is meshed, as it is on its own."""
    mesher = Counting()
    particles, topology = scene_of(0.0, 0.011, 0.022, 0.033, 0.044)
    found = mesh_frames(mesher, particles, topology)
    assert mesher.asked == 3
    for frame, meshed in enumerate([0, 0, 2, 2, 4]):
        alone = DualContouring().mesh(
            particles.positions[meshed], topology.frames[meshed], spacing=SPACING
        )
        assert np.array_equal(found[frame].meshes[0].vertices, alone.meshes[0].vertices)


@pytest.mark.parametrize("change", ["labels", "genus", "contacts"])
def test_a_changed_record_is_meshed(change: str) -> None:
    """Particles that lie still are meshed again when the check says something else of them."""
    mesher = Counting()
    particles, topology = scene_of(0.0, 0.0)
    frame = topology.frames[1]
    labels = frame.labels.copy()
    labels[0] = 255
    other = {
        "labels": replace(frame, labels=labels),
        "genus": replace(frame, genus=(1,)),
        "contacts": replace(frame, contacts=np.array([[0, 1]], np.int32)),
    }[change]
    mesh_frames(mesher, particles, replace(topology, frames=(frame, other)))
    assert mesher.asked == 2
