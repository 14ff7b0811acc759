"""Baselines: the static check of plates with holes, the table against that of the model."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from doughdata.torch import DoughSequences
from doughnet.baselines.methods import Copy, Model, Vpm, evaluate_method
from doughnet.baselines.occupancy import static_components
from doughnet.baselines.simulated import Simulated
from doughnet.config import ModelConfig
from doughnet.evaluate import evaluate
from doughnet.intervals import bootstrap
from doughnet.lattice import Lattice
from doughnet.metrics import TopologyScore
from doughnet.model import DoughNet
from doughnet.tables import Scored, table_row, with_steps
from doughschemas import SimulationError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip
SMALL = Lattice(first=(-40, -40, -3), shape=(81, 81, 44))


def plate(holes: int, shape: tuple[int, int, int]) -> np.ndarray:
    """A plate of 12 nodes' width with square holes in a row, and a hollow that is no handle."""
    solid = np.zeros(shape, bool)
    solid[2 : 8 + 10 * holes, 2:14, 2:7] = True
    solid[3, 3, 4] = False
    for k in range(holes):
        solid[7 + 10 * k : 11 + 10 * k, 6:10] = False
    return solid


@pytest.mark.parametrize("holes", [0, 1, 2, 3])
def test_static_components_count_pieces_and_holes(holes: int) -> None:
    """Two plates apart are two components, the larger first; crumbs are none."""
    shape = (45, 40, 12)
    dough = plate(holes, shape) | np.roll(plate(1, shape), 20, axis=1)
    dough[42, 38, 10] = True
    labels, genus = static_components(dough, smallest=30)
    assert sorted(genus) == sorted([holes, 1])
    sizes = [int((labels == k).sum()) for k in range(len(genus))]
    assert sizes == sorted(sizes, reverse=True)
    assert sum(sizes) == dough.sum() - 1
    assert (labels[~dough] == len(genus)).all()
    assert len(static_components(dough, smallest=1)[1]) == 3


def test_what_touches_is_one_for_the_static_check() -> None:
    """Even by a corner: it cannot tell touching from merged."""
    dough = np.zeros((20, 20, 20), bool)
    dough[2:8, 2:8, 2:8] = dough[8:14, 8:14, 8:14] = True
    assert len(static_components(dough, smallest=1)[1]) == 1
    assert static_components(np.zeros((4, 4, 4), bool))[1] == []


@pytest.fixture(scope="module")
def sequences(tmp_path_factory: pytest.TempPathFactory) -> DoughSequences:
    path = tmp_path_factory.mktemp("baselines") / "dataset"
    uri = write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri
    return DoughSequences(uri, length=None, sensor="none", num_points=64, num_queries=1)


@pytest.fixture(scope="module")
def model() -> DoughNet:
    torch.manual_seed(0)
    return DoughNet(NANO).eval()


def test_model_and_copy_have_the_rows_of_the_whole_table(
    sequences: DoughSequences, model: DoughNet
) -> None:
    """`evaluate_method` of the model and of copying gives what `evaluate` gives."""
    whole = evaluate(model, sequences, lattice=SMALL)
    for method, row in ((Model(model), "full_sequence"), (Copy(), "copy_first_frame")):
        table = evaluate_method(method, sequences, lattice=SMALL)
        found = {k: v for k, v in table["full_sequence"].items() if k in whole[row]}
        assert found == {k: whole[row][k] for k in found}
        assert found.keys() >= {"viou", "balanced_accg", "interval"}
        assert table["scenes"] == len(sequences)
        assert table["failed"] == 0
    assert found["frames"] == sum(len(sequences[k]["genus"]) - 1 for k in range(len(sequences)))


def test_vpm_keeps_the_volume_and_names_it_anew(sequences: DoughSequences, model: DoughNet) -> None:
    """The same dough as the model's, its components those of `static_components`."""
    sample = sequences[0]
    for (ours, genus), (labels, own) in zip(
        Model(model).sequence(sample, (), SMALL),
        Vpm(model).sequence(sample, (), SMALL),
        strict=True,
    ):
        dough = (ours < len(genus)).numpy()
        wanted, wanted_genus = static_components(dough)
        np.testing.assert_array_equal(labels, wanted)
        assert own == wanted_genus
        assert ndimage.label(labels < len(own), np.ones((3, 3, 3)))[1] == len(own)


def test_a_simulation_that_fails_leaves_the_reconstruction(
    sequences: DoughSequences, model: DoughNet
) -> None:
    """It is counted, and the other scenes go on."""

    class Broken:
        def play(self, shape, frames):
            del shape, frames
            raise SimulationError("dough left the domain")

    method = Simulated(model, Broken())
    table = evaluate_method(method, sequences, lattice=SMALL)
    assert table["failed"] == len(sequences)
    assert 0 <= table["final"]["viou"] <= 100


def test_intervals_are_those_of_the_mean() -> None:
    """Of a normal sample: mean +- 1.96 standard errors, within a tenth; of one value, itself."""
    values = np.random.default_rng(0).normal(50, 10, 200)
    low, high = bootstrap(200, lambda times: {"mean": float(times @ values / 200)})["mean"]
    error = np.std(values) / np.sqrt(len(values))
    assert (low + high) / 2 == pytest.approx(np.mean(values), abs=0.1 * error + 0.05)
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=0.1)
    assert bootstrap(1, lambda times: {"mean": 7.0 * times[0]}) == {"mean": [7.0, 7.0]}
    assert bootstrap(0, lambda times: {"sum": float(times.sum())}) == {}


def frame(right: bool, *genus: int, volume: float = 0.5) -> Scored:
    """A scored frame whose true components have these genera."""
    score = TopologyScore(volume_iou=volume, component_iou=0.25, right_count=True,
                          right_genus=right, genus_share=float(right))  # fmt: skip
    return Scored(score=score, topology=tuple(sorted(genus)))


def test_a_row_is_what_counting_gives() -> None:
    """Means over frames, balanced accuracy over the topologies that occur, steps and scenes alone;
    the interval of a figure that no scene differs in has no width.
    """
    scenes = [
        [frame(True, 0), frame(False, 1), frame(True, 0)],
        [],
        [frame(False, 0, 0, volume=1.0)],
    ]
    row = with_steps(scenes)
    assert (row["viou"], row["ciou"], row["accc"], row["accg"]) == (62.5, 25.0, 100.0, 50.0)
    assert row["balanced_accg"] == pytest.approx(100 / 3, abs=0.01)  # ring and pair never right
    assert row["frames"] == 4
    assert row["interval"]["accc"] == [100.0, 100.0]
    assert row["interval"]["viou"] == [50.0, 100.0]  # one scene alone may be drawn
    assert [step["frames"] for step in row["by_step"]] == [2, 1, 1]
    assert [step["accg"] for step in row["by_step"]] == [50.0, 0.0, 100.0]
    assert [own["viou"] for own in row["by_scene"]] == [50.0, 0.0, 100.0]
    assert table_row([])["interval"] == {}
