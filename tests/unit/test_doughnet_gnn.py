"""The particle network: distances of clouds, symmetries, windows, learning, the method."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from doughcli.net_player import dough_around
from doughdata.torch import DoughSequences
from doughnet.baselines.gnn import Gnn, load_particle_net
from doughnet.baselines.methods import evaluate_method
from doughnet.baselines.particle_data import ParticleWindows, finger_points, spacing_of, spread
from doughnet.baselines.particle_net import ParticleConfig, ParticleNet
from doughnet.baselines.particle_stage import ParticleStage, chamfer, earth_mover
from doughnet.config import ModelConfig
from doughnet.lattice import Lattice
from doughnet.model import DoughNet
from doughnet.weights import load_weights, save_weights
from doughschemas import BadInputError
from tests.closed_form import NUM_FRAMES, cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

FEW = ParticleConfig(particles=40, history=3, tool_points=8, width=24, rounds=2)
NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip
SMALL = Lattice(first=(-40, -40, -3), shape=(81, 81, 44))


def clouds(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_chamfer_is_that_of_a_search_tree() -> None:
    """Both directions' mean distance to the nearest point, as scipy finds it."""
    a, b = clouds(2, 30, 3), clouds(2, 50, 3, seed=1)
    each = [
        (KDTree(q).query(p)[0].mean() + KDTree(p).query(q)[0].mean()) / 2
        for p, q in zip(a.numpy(), b.numpy(), strict=True)
    ]
    assert chamfer(a, b).item() == pytest.approx(np.mean(each), rel=1e-5)


def test_earth_mover_is_the_least_of_all_matchings() -> None:
    """Against every one of 120 matchings; the order of points does not matter."""
    a, b = clouds(1, 5, 3), clouds(1, 5, 3, seed=1)
    every = [(a[0] - b[0, list(order)]).norm(dim=1).mean() for order in permutations(range(5))]
    assert earth_mover(a, b).item() == pytest.approx(min(every).item(), rel=1e-6)
    assert earth_mover(a, b[:, [3, 1, 4, 0, 2]]).item() == pytest.approx(min(every).item())


def random_net(seed: int = 0) -> ParticleNet:
    """A network that moves something: its last layer is not zero."""
    torch.manual_seed(seed)
    net = ParticleNet(FEW)
    torch.nn.init.normal_(net.motion.weight)
    return net.eval()


def moment(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Particles of three key frames, tool points of two, and the spacing [m]."""
    history = 0.02 * clouds(1, FEW.history, 40, 3, seed=seed)
    return history, 0.02 * clouds(1, 2, 16, 3, seed=seed + 1), torch.tensor([0.008])


@torch.inference_mode()
def test_motion_does_not_depend_on_names_or_on_where_the_scene_lies() -> None:
    """Permuted particles move as before; a scene shifted over the table is shifted."""
    net, (history, tool, spacing) = random_net(), moment()
    after = net(history, tool, spacing)
    order = torch.randperm(40, generator=torch.Generator().manual_seed(2))
    turned = net(history[:, :, order], tool.flip(2), spacing)
    torch.testing.assert_close(turned, after[:, order], rtol=0, atol=1e-6)
    shift = torch.tensor([0.03, -0.02, 0.0])
    torch.testing.assert_close(
        net(history + shift, tool + shift, spacing), after + shift, rtol=0, atol=1e-6
    )
    assert (after - history[:, -1]).norm(dim=2).min() > 0
    raised = net(history + 0.004 * torch.eye(3)[2], tool + 0.004 * torch.eye(3)[2], spacing)
    assert (raised - after - 0.004 * torch.eye(3)[2]).abs().max() > 1e-4  # the table stays


@torch.inference_mode()
def test_scenes_of_a_batch_do_not_touch() -> None:
    """Two scenes at the same place give what each gives alone."""
    net = random_net()
    first, second = moment(0), moment(7)
    both = net(*(torch.cat(pair) for pair in zip(first, second, strict=True)))
    alone = torch.cat([net(*first), net(*second)])
    torch.testing.assert_close(both, alone, rtol=0, atol=1e-6)


@torch.inference_mode()
def test_what_is_far_from_everything_is_not_moved_by_the_tool() -> None:
    """A tool out of reach of all particles changes nothing."""
    net, (history, tool, spacing) = random_net(), moment()
    far = tool + torch.tensor([1.0, 0.0, 0.0])
    moved = far + torch.tensor([[0.0], [1.0]])[None, :, :, None] * 0.01
    torch.testing.assert_close(net(history, far, spacing), net(history, moved, spacing))


def test_spread_points_are_farthest_from_each_other() -> None:
    """Of a line of 101 points the first five chosen are its ends, its middle and its quarters."""
    line = torch.zeros(101, 3)
    line[:, 0] = torch.arange(101)
    assert sorted(spread(line, 5).tolist()) == [0, 25, 50, 75, 100]
    assert spread(line[:2], 5).tolist() == [0, 1, 0, 1, 0]


@pytest.fixture(scope="module")
def uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("particles") / "dataset"
    return write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri


def test_windows_follow_the_same_particles(uri: str) -> None:
    """The rows of every key frame are the same particles; the first stands for what was before."""
    data = ParticleWindows(uri, config=FEW, frames=range(NUM_FRAMES), steps=1)
    assert len(data) == 2 * (NUM_FRAMES - 1)
    for example, window in ((cut_ring(), data[1]), (joined_bars(), data[3])):
        positions = example.particles.positions
        index = KDTree(positions[1]).query(window["history"][-1].numpy())[1]
        np.testing.assert_array_equal(window["history"].numpy(), positions[[0, 0, 1]][:, index])
        np.testing.assert_array_equal(window["target"].numpy(), positions[[2]][:, index])
        volume = len(positions[0]) * example.particles.spacing**3
        assert window["spacing"].item() ** 3 * FEW.particles == pytest.approx(volume, rel=1e-5)
        assert window["tool"].shape == (2, 2 * FEW.tool_points, 3)


def test_tool_points_move_as_the_fingers_do(uri: str) -> None:
    """From key frame to key frame each finger's points are moved rigidly, by its pose."""
    source = DoughSequences(uri, length=None, sensor="none", num_points=8, num_queries=1).source
    frames = [source.frame(scene=0, frame=k) for k in (0, 2)]
    points = finger_points(frames, 8, seed=1).reshape(2, 2, 8, 3)
    for finger in range(2):
        step = frames[1].tools.position[finger] - frames[0].tools.position[finger]
        moved = (points[1, finger] - points[0, finger]).numpy()
        np.testing.assert_allclose(moved, np.broadcast_to(step, (8, 3)), atol=1e-6)


def test_too_few_key_frames_are_told(uri: str) -> None:
    """One line says what was asked for."""
    with pytest.raises(BadInputError, match="3 key frames"):
        ParticleWindows(uri, config=FEW, frames=(0, 1))


def test_it_learns_that_what_is_pushed_moves() -> None:
    """Clouds that move with the tool around them, always from one side: the error halves."""
    torch.manual_seed(0)
    stage = ParticleStage(ParticleNet(FEW))
    optimiser = torch.optim.Adam(stage.parameters(), lr=3e-3)
    start = 0.02 * torch.rand(2, 40, 3, generator=torch.Generator().manual_seed(3))
    push = torch.tensor([0.004, 0.0, 0.0])
    batch = {
        "history": torch.stack([start] * FEW.history, dim=1),
        "target": torch.stack([start + push, start + 2 * push], dim=1),
        "tool": torch.stack([start[:, :16] + k * push for k in range(3)], dim=1),
        "spacing": torch.full((2,), spacing_of(0.02**3, 40)),
    }
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        losses.append(stage(batch, seed=0)["loss"])
        losses[-1].backward()
        optimiser.step()
    assert losses[-1].item() < losses[0].item() / 2


def test_particles_at_rest_keep_the_dough_that_was_seen(uri: str) -> None:
    """A new network moves nothing: all key frames are alike, scored like any other method's."""
    torch.manual_seed(0)
    sequences = DoughSequences(uri, length=None, sensor="none", num_points=64, num_queries=1)
    method = Gnn(Ball(), ParticleNet(FEW).eval(), dough_around)
    (labels, genus), *others = method.sequence(
        sequences[0], [sequences.source.frame(scene=0, frame=k) for k in range(3)], SMALL
    )
    assert list(genus) == [0]
    volume = (np.asarray(labels) == 0).sum()
    assert volume == pytest.approx(4 / 3 * np.pi * 15**3, rel=0.1)  # nodes are 1 mm apart
    for other, own in others:
        np.testing.assert_array_equal(other, labels)
        assert list(own) == list(genus)
    table = evaluate_method(method, sequences, lattice=SMALL)
    assert (table["method"], table["failed"]) == ("gnn", 0)
    assert 0 <= table["final"]["viou"] <= 100


def test_numbers_that_overflow_are_a_failed_scene(uri: str) -> None:
    """What was predicted before stays, the rest is empty, and the scene is counted."""
    sequences = DoughSequences(uri, length=None, sensor="none", num_points=64, num_queries=1)
    method = Gnn(Ball(), Bursting(FEW).eval(), dough_around)
    frames = [sequences.source.frame(scene=0, frame=k) for k in range(NUM_FRAMES)]
    first, *later = method.sequence(sequences[0], frames, SMALL)
    assert list(first[1]) == [0]
    assert [(np.asarray(labels).any(), list(genus)) for labels, genus in later] == [(False, [])]
    assert method.failed == 1


class Bursting(ParticleNet):
    """A network at rest whose second step overflows."""

    steps = 0

    def forward(
        self, history: torch.Tensor, tool: torch.Tensor, spacing: torch.Tensor
    ) -> torch.Tensor:
        """The last key frame, then infinities."""
        del tool, spacing
        self.steps += 1
        return history[:, -1] * (1.0 if self.steps == 1 else torch.inf)


class Ball(DoughNet):
    """A model that sees a ball of 15 mm radius in every view."""

    def __init__(self) -> None:
        super().__init__(NANO)

    def decode(self, latents: torch.Tensor, lattice: Lattice) -> "Seen":  # type: ignore[override]
        """The ball on a lattice."""
        del latents
        points = lattice.points(torch.arange(lattice.count))
        inside = (points - torch.tensor([0.0, 0.0, 0.016])).norm(dim=1) < 0.015
        return Seen(torch.where(inside, 0, 1).reshape(lattice.shape))


class Seen:
    """What `DoughNet.decode` gives, as far as a method asks."""

    def __init__(self, labels: torch.Tensor) -> None:
        self.labels = labels

    def components(self) -> tuple[torch.Tensor, Sequence[int]]:
        """One component without a hole."""
        return self.labels, [0]


def test_weights_come_back_and_are_told_apart(tmp_path: Path) -> None:
    """What was saved is loaded, from the folder or beside another stage; a DoughNet it is not."""
    net = random_net()
    save_weights(net, tmp_path / "gnn", provenance={"stage": "gnn"})
    (tmp_path / "dynamics").mkdir()
    for folder in (tmp_path, tmp_path / "dynamics"):
        found = load_particle_net(folder)
        assert asdict(found.config) == asdict(FEW)
        for name, value in net.state_dict().items():
            torch.testing.assert_close(found.state_dict()[name], value)
    assert json.loads((tmp_path / "gnn" / "config.json").read_text())["stage"] == "gnn"
    with pytest.raises(BadInputError, match="not a model config"):
        load_weights(tmp_path / "gnn")
    with pytest.raises(BadInputError, match="doughnet train gnn"):
        load_particle_net(tmp_path / "nowhere" / "dynamics")
