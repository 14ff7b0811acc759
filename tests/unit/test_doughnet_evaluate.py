"""Metrics against independent computations: trimesh, scipy's assignment, plain counting."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.optimize import linear_sum_assignment

from doughdata.dataset import open_dataset
from doughdata.scenes import finger_mesh
from doughdata.torch import DoughSequences
from doughdata.torch.sampling import inside_tools
from doughnet.config import ModelConfig
from doughnet.evaluate import Truth, evaluate, score_frame
from doughnet.lattice import Lattice, on_lattice
from doughnet.metrics import UNASSIGNED, score
from doughnet.model import DoughNet
from doughschemas import NO_COMPONENT, BadInputError, LabelGrid
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip


@pytest.fixture(scope="module")
def uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("evaluate") / "dataset"
    return write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri


def plain_iou(a: np.ndarray, b: np.ndarray) -> float:
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0


def test_metrics_agree_with_voxels_of_trimesh_and_scipy() -> None:
    """On 50 random frames of boxes, balls and tori, VIoU and CIoU are those of trimesh's point
    tests on the same lattice under scipy's assignment, and counts and genera are compared by hand.
    """
    rng = np.random.default_rng(0)
    lattice = Lattice(first=(-10, -10, 0), shape=(21, 21, 11), spacing=4e-3)
    points = lattice.points(torch.arange(lattice.count)).double().numpy()
    for _ in range(50):
        predicted, true = (random_frame(rng, points) for _ in range(2))
        labels = [np.where(m.any(0), m.argmax(0), len(m)) for m, _ in (predicted, true)]
        found = score(
            torch.from_numpy(labels[0]),
            torch.from_numpy(labels[1]),
            predicted_genus=predicted[1],
            true_genus=true[1],
        )
        masks = [np.stack([lab == k for k in range(len(m))]) for lab, (m, _) in
                 zip(labels, (predicted, true), strict=True)]  # fmt: skip
        assert found.volume_iou == pytest.approx(plain_iou(masks[0].any(0), masks[1].any(0)))
        table = np.array([[plain_iou(p, t) for t in masks[1]] for p in masks[0]])
        rows, columns = linear_sum_assignment(-table)
        assert found.component_iou == pytest.approx(table[rows, columns].sum() / len(masks[1]))
        right = [predicted[1][p] == true[1][t] for p, t in zip(rows, columns, strict=True)]
        same = len(predicted[1]) == len(true[1])
        assert found.right_count == same
        assert found.right_genus == (same and all(right))
        assert found.genus_share == pytest.approx(sum(right) / len(true[1]))


def random_frame(rng: np.random.Generator, points: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Membership of the points in one to three convex meshes, tested by trimesh; random genera."""
    masks = []
    for _ in range(rng.integers(1, 4)):
        if rng.random() < 0.5:
            mesh = trimesh.creation.box(extents=rng.uniform(0.01, 0.03, 3))
        else:
            mesh = trimesh.creation.icosphere(subdivisions=1, radius=rng.uniform(0.006, 0.014))
        mesh.apply_translation([*rng.uniform(-0.02, 0.02, 2), rng.uniform(0.01, 0.03)])
        masks.append(trimesh.convex.is_convex(mesh) and inside_convex(mesh, points))
    return np.stack(masks), rng.integers(0, 3, len(masks)).tolist()


def inside_convex(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Points behind all faces of a convex mesh."""
    heights = np.einsum("pfk,fk->pf", points[:, None] - mesh.triangles_center, mesh.face_normals)
    return heights.max(axis=1) <= 1e-9


def test_dough_of_no_component_counts_for_the_volume_alone() -> None:
    """A negative label keeps VIoU and lowers CIoU."""
    true = torch.tensor([0, 0, 0, 0, 1, 1])
    predicted = torch.tensor([0, 0, UNASSIGNED, UNASSIGNED, 1, 1])
    got = score(predicted, true, predicted_genus=[0], true_genus=[0])
    assert (got.volume_iou, got.component_iou) == (1.0, 0.5)


def test_the_truth_scores_a_hundred_and_the_tool_is_left_out(uri: str) -> None:
    """The true labels score one; wrong labels inside a finger alone change nothing."""
    source = open_dataset(uri)
    lattice = Lattice(first=(-60, -30, 0), shape=(121, 61, 41))
    for scene in range(2):
        frame = source.frame(scene=scene, frame=2)
        labels = torch.from_numpy(on_lattice(frame.label_grid, lattice).astype(np.int64))
        truth = Truth(labels=labels, genus=tuple(frame.topology.genus), tools=frame.tools)
        perfect = score_frame(labels, truth.genus, truth, lattice)
        assert (perfect.volume_iou, perfect.component_iou, perfect.right_genus) == (1.0, 1.0, True)
        points = lattice.points(torch.arange(lattice.count)).double().numpy()
        covered = torch.from_numpy(inside_tools(frame.tools, points)).reshape(labels.shape)
        assert covered.any()
        spoiled = torch.where(covered, 0, labels)
        assert score_frame(spoiled, truth.genus, truth, lattice) == perfect
        beside = torch.where(covered.roll(25, dims=1) & ~covered, 0, labels)
        assert score_frame(beside, truth.genus, truth, lattice).volume_iou < 1.0


def test_inside_a_finger_is_what_trimesh_says(uri: str) -> None:
    """Points inside the posed finger meshes are found, up to those on the surface."""
    frame = open_dataset(uri).frame(scene=0, frame=1)
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.08, -0.05, 0.0], [0.08, 0.05, 0.06], (20_000, 3))
    expected = np.zeros(len(points), bool)
    for position, quaternion in zip(frame.tools.position, frame.tools.quaternion, strict=True):
        mesh = finger_mesh(frame.tools.tool)
        pose = trimesh.transformations.quaternion_matrix(np.roll(quaternion, 1))
        pose[:3, 3] = position
        mesh.apply_transform(pose)
        expected |= inside_convex(mesh, points)
    assert expected.any()
    assert np.array_equal(inside_tools(frame.tools, points), expected)


def test_grids_are_placed_on_the_lattice() -> None:
    """Nodes land at their positions, those outside are cut, another lattice is refused."""
    lattice = Lattice(first=(-2, -2, 0), shape=(5, 5, 3))
    grid = LabelGrid(labels=np.arange(8, dtype=np.uint8).reshape(2, 2, 2),
                     origin=np.array([0.002, -0.002, -0.001]), spacing=1e-3)  # fmt: skip
    placed = on_lattice(grid, lattice)
    assert placed[4, 0, 0] == 1
    assert placed[4, 1, 0] == 3
    assert (placed != NO_COMPONENT).sum() == 2
    with pytest.raises(BadInputError, match="multiples of 1 mm"):
        on_lattice(LabelGrid(labels=grid.labels, origin=grid.origin + 4e-4, spacing=1e-3), lattice)


def test_the_table_of_a_dataset(uri: str) -> None:
    """Every row counts its frames; copying the first frame is what plain counting gives; a perfect
    copy cannot beat itself, and an untrained dynamics model repeats the first reconstruction.
    """
    torch.manual_seed(0)
    data = DoughSequences(uri, length=None, sensor="none", num_points=64, num_queries=1)
    lattice = Lattice(first=(-25, -25, 0), shape=(51, 51, 16))  # all dough of the examples
    table = evaluate(DoughNet(NANO).eval(), data, lattice=lattice)
    frames = {
        name: row["frames"]
        for name, row in table.items()
        if isinstance(row, dict) and "frames" in row
    }
    assert frames == {"reconstruction": 6, "ceiling": 4, "single_step": 4, "full_sequence": 4,
                      "final": 2, "copy_first_frame": 4}  # fmt: skip
    source, volumes = data.source, []
    for scene in range(2):
        grids = [
            on_lattice(source.frame(scene=scene, frame=k).label_grid, lattice) for k in range(3)
        ]
        every = lattice.points(torch.arange(lattice.count)).double().numpy()
        for k in (1, 2):
            tools = source.frame(scene=scene, frame=k).tools
            free = ~inside_tools(tools, every).reshape(grids[0].shape)
            a, b = ((grid != NO_COMPONENT) & free for grid in (grids[0], grids[k]))
            volumes.append(100 * plain_iou(a, b))
    row = table["copy_first_frame"]
    assert row["viou"] == pytest.approx(np.mean(volumes), abs=0.01)
    assert row["final_viou"] == pytest.approx(np.mean(volumes[1::2]), abs=0.01)
    assert row["accc"] == pytest.approx(100 * 2 / 4)  # the cut ring: 1, 1 -> 2; the bars 2 -> 1
    for name in ("reconstruction", "full_sequence", "final"):
        assert name in table["unlabelled"]
    assert 0 <= table["inconsistent"] <= 4
