"""Training: it learns, it can be killed at any step, and its files tell what they are."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from itertools import repeat
from pathlib import Path

import pytest
import torch

from doughnet.augment import Augmentation
from doughnet.averaging import WeightAverage
from doughnet.config import ModelConfig
from doughnet.gate import train_and_score
from doughnet.model import DoughNet
from doughnet.muon import BatchedMuon, orthogonalised
from doughnet.optimisers import OptimiserConfig, learning_rate, optimisers
from doughnet.procedural import stream
from doughnet.stages import AutoencoderStage, DynamicsStage
from doughnet.train import Budget, TrainConfig, fit
from doughnet.weights import load_weights, save_weights
from doughschemas import BadInputError

NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip
STEPS = 60
CONFIG = TrainConfig(checkpoint_seconds=0.0, record_every=10)
SCRIPT = """
import sys, torch
torch.set_num_threads(1)
from pathlib import Path
from tests.unit.test_doughnet_training import train
train(Path(sys.argv[1]), resume=True)
"""


def train(out: Path, *, steps: int = STEPS, resume: bool = False) -> None:
    torch.manual_seed(0)
    stage = AutoencoderStage(DoughNet(NANO))
    batches = lambda step: stream(0, batch_size=2, step=step)  # noqa: E731
    fit(stage, batches, Budget(steps=steps), config=CONFIG, out=out, resume=resume,
        provenance={"data": "procedural"})  # fmt: skip


def tensors(folder: Path) -> dict[str, torch.Tensor]:
    return load_weights(folder).model.state_dict()


def saved_step(out: Path) -> int:
    """Step of the newest weights, 0 before there are any."""
    path = out / "config.json"
    return json.loads(path.read_text())["state"]["step"] if path.exists() else 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    train(out)
    torch.set_num_threads(threads)
    return out


def test_killed_and_resumed_gives_the_same_weights(whole: Path, tmp_path: Path) -> None:
    """Killed at any moment (SIGKILL) and resumed, a training ends with the same weights, bit for
    bit, and its journal has every step once.
    """
    out = tmp_path / "killed"
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    command = [sys.executable, "-c", SCRIPT, str(out)]
    process = subprocess.Popen(command, env=environment, start_new_session=True)
    until, least = time.monotonic() + 120, random.Random().randrange(1, STEPS - 20)
    while saved_step(out) < least and time.monotonic() < until:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    state = torch.load(out / "training.pt", weights_only=True)
    assert least <= state["step"] < STEPS, "not killed where it means anything"
    subprocess.run(command, env=environment, check=True)
    one, two = tensors(whole), tensors(out)
    assert all(torch.equal(one[name], two[name]) for name in one)
    with (out / "metrics.csv").open(newline="") as file:
        steps = [int(row["step"]) for row in csv.DictReader(file)]
    assert steps == list(range(10, STEPS + 1, 10))
    assert not list(out.glob(".tmp-*")) or state  # a killed writer may leave one, never more
    assert {path.name for path in out.iterdir()} >= {"config.json", "weights.safetensors"}


def test_a_training_says_where_it_comes_from(whole: Path) -> None:
    """Config and provenance stand in JSON beside the tensors and inside them alike."""
    document = json.loads((whole / "config.json").read_text())
    loaded = load_weights(whole)
    assert loaded.model.config == NANO
    assert document["data"] == loaded.provenance["data"] == "procedural"
    assert document["state"]["step"] == STEPS
    assert not any(parameter.requires_grad for parameter in loaded.model.parameters())


def test_resuming_something_else_is_refused(whole: Path) -> None:
    """A checkpoint of another configuration is no place to go on from."""
    stage = AutoencoderStage(DoughNet(NANO))
    batches = lambda step: stream(0, batch_size=2, step=step)  # noqa: E731
    with pytest.raises(BadInputError, match="another --out"):
        fit(stage, batches, Budget(steps=1), config=TrainConfig(seed=5), out=whole, resume=True)


def test_damaged_and_missing_weights_are_told(whole: Path, tmp_path: Path) -> None:
    """A cut file, an empty folder and a strange file are one clear error each."""
    data = (whole / "weights.safetensors").read_bytes()
    cut = tmp_path / "weights.safetensors"
    with pytest.raises(BadInputError, match="doughnet train autoencoder"):
        load_weights(tmp_path)
    for damaged in (data[: len(data) // 2], b"", b"no weights at all"):
        cut.write_bytes(damaged)
        with pytest.raises(BadInputError, match="damaged"):
            load_weights(tmp_path)


def test_half_precision_weights_predict_nearly_the_same(tmp_path: Path) -> None:
    """Stored in bfloat16 the file is half as long, and latents move by less than a hundredth."""
    torch.manual_seed(0)
    model = DoughNet(NANO).eval()
    save_weights(model, tmp_path / "full", provenance={})
    save_weights(model, tmp_path / "half", provenance={}, dtype=torch.bfloat16)
    sizes = [(tmp_path / n / "weights.safetensors").stat().st_size for n in ("full", "half")]
    assert sizes[1] < 0.6 * sizes[0]
    batch = next(stream(0, batch_size=2))
    full = model.encode(batch["points"], batch["point_labels"])
    half = load_weights(tmp_path / "half").model.encode(batch["points"], batch["point_labels"])
    assert (full - half).square().mean().sqrt() < 0.01


def test_the_second_stage_leaves_the_autoencoder_alone() -> None:
    """Dynamics training moves the dynamics and the genus head, and no other weight of the first
    stage; it beats copying on frames that move.
    """
    torch.manual_seed(0)
    model = DoughNet(NANO)
    before = {n: p.clone() for n, p in model.named_parameters()}
    moving = _moving_frames()
    same = Augmentation(turn=0.0, point_noise=0.0, point_dropout=0.0,
                        shuffle_components=False, label_dropout=0.0)  # fmt: skip
    stage = DynamicsStage(model, augmentation=same)
    copied = stage(moving, seed=0)["latent"].item()
    config = TrainConfig(optimiser=OptimiserConfig(warm_up=0.0))
    fit(stage, lambda _: repeat(moving), Budget(steps=60), config=config)
    assert stage(moving, seed=0)["latent"].item() < 0.8 * copied
    moved = {n for n, p in model.named_parameters() if not torch.equal(p, before[n])}
    assert moved
    assert all(n.startswith(("dynamics.", "autoencoder.decoder.genus.")) for n in moved)


def _moving_frames() -> dict[str, torch.Tensor]:
    """Four scenes of three frames; everything moves 2 cm between frames."""
    one = next(stream(0, batch_size=4))
    shift = torch.tensor([0.02, 0.0, 0.0]) * torch.arange(3.0)[:, None, None]
    batch = {n: v[:, None].expand(-1, 3, *v.shape[1:]).clone() for n, v in one.items()}
    for name in ("points", "queries"):
        batch[name] = batch[name] + shift
    tool = torch.rand(4, 1, 2, 16, 3, generator=torch.Generator().manual_seed(0)) * 0.05
    batch["tool_points"] = tool + shift[:, None]
    return batch


def test_muon_gets_the_matrices_between_tokens() -> None:
    """Every trained parameter has one optimiser; Muon has matrices of blocks and nothing else."""
    stage = AutoencoderStage(DoughNet(NANO))
    adamw, muon = optimisers(stage, OptimiserConfig())
    names = {id(p): n for n, p in stage.named_parameters()}
    held = [{names[id(p)] for g in o.param_groups for p in g["params"]} for o in (adamw, muon)]
    assert not held[0] & held[1]
    assert held[0] | held[1] == {n for n, p in stage.named_parameters() if p.requires_grad}
    assert all(".attention." in n or ".feed_forward." in n for n in held[1])
    assert any("genus" in n for n in held[0])
    assert len(optimisers(stage, OptimiserConfig(muon=False))) == 1


def test_muon_is_the_librarys() -> None:
    """Ten steps of float32 Muon are ten of `torch.optim.Muon` within the latter's bfloat16, and a
    singular value between 1e-3 and 1 of the norm ends near 1.
    """
    rng = torch.Generator().manual_seed(0)
    starts = [torch.randn(shape, generator=rng) for shape in ((24, 40), (40, 24), (24, 40))]
    ends = []
    for make, options in (
        (BatchedMuon, {}),
        (torch.optim.Muon, {"adjust_lr_fn": "match_rms_adamw"}),
    ):
        parameters = [torch.nn.Parameter(start.clone()) for start in starts]
        optimiser = make(parameters, lr=0.02, weight_decay=0.1, **options)
        for step in range(10):
            for k, parameter in enumerate(parameters):
                parameter.grad = torch.sin(parameter.detach() * (k + 1) + step)
            optimiser.step()
        ends.append([parameter.detach() for parameter in parameters])
    for start, ours, theirs in zip(starts, *ends, strict=True):
        assert (ours - theirs).norm() < 0.02 * (ours - start).norm()
    spectrum = torch.logspace(-3, 0, 16)
    left, right = (torch.linalg.qr(torch.randn(2, 16, 16, generator=rng))[0] for _ in range(2))
    found = torch.linalg.svdvals(orthogonalised(left @ torch.diag(spectrum) @ right, steps=8))
    assert (found > 0.5).all()
    assert (found < 1.3).all()


def test_the_learning_rate_rises_stays_and_falls_to_zero() -> None:
    """Trapezoid: zero at both ends, the configured rate between warm-up and cool-down."""
    config = OptimiserConfig(learning_rate=1.0, warm_up=0.1, cool_down=0.4)
    rates = [learning_rate(p, config) for p in (0.0, 0.05, 0.1, 0.6, 0.8, 1.0)]
    assert rates == pytest.approx([0.0, 0.5, 1.0, 1.0, 0.5, 0.0])


def test_the_average_of_constant_weights_is_the_weights() -> None:
    """A constant is its own average, a jump is followed geometrically, and swapping twice is
    nothing.
    """
    layer = torch.nn.Linear(2, 1, bias=False)
    average = WeightAverage(layer, decay=0.5)
    start = layer.weight.detach().clone()
    with torch.no_grad():
        layer.weight.add_(1.0)
    shares = []
    for n in range(1, 6):
        average.update()
        shares.append(1 - min(0.5, (1 + n) / (10 + n)))
    left = torch.tensor([1 - share for share in shares]).prod()
    average.swap()
    torch.testing.assert_close(layer.weight, start + 1 - left)
    average.swap()
    torch.testing.assert_close(layer.weight, start + 1)


def test_a_budget_is_steps_or_seconds() -> None:
    """Exactly one of the two; progress is the share that is spent."""
    assert Budget(steps=10).progress(5, 99.0) == 0.5
    assert Budget(seconds=10.0).progress(99, 5.0) == 0.5
    for wrong in ({}, {"steps": 1, "seconds": 1.0}):
        with pytest.raises(BadInputError, match="either"):
            Budget(**wrong)


@pytest.mark.slow
def test_micro_learns_procedural_shapes() -> None:
    """After three minutes' worth of steps on one core, held-out shapes are found at VIoU >= 70."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        result = train_and_score(Budget(steps=1700), held_out=32)
    finally:
        torch.set_num_threads(threads)
    assert result.viou >= 70, result
    assert result.ciou >= 65, result
