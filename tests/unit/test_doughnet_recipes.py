"""The ablations change one decision each, and it is the one that they name."""

from pathlib import Path

import numpy as np
import pytest
import torch

from doughdata.torch import DoughDataset
from doughdata.torch.sampling import NO_POINT, complete_points
from doughnet.config import ModelConfig
from doughnet.data import LoaderConfig, key_frames
from doughnet.model import DoughNet
from doughnet.recipes import RECIPES, recipe
from doughnet.runs import RunConfig, train_stage
from doughnet.stages import DynamicsStage
from doughnet.train import new_fabric
from doughnet.weights import load_weights
from doughschemas import ComponentMesh, UnknownNameError
from tests.closed_form import cut_ring, joined_bars
from tests.dataset_helpers import new_writer, write_examples

NANO = ModelConfig(latents=8, width=24, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("scenes") / "dough"
    return write_examples(new_writer(path), [cut_ring(), joined_bars()]).uri


def batch(frames: int = 3, count: int = 2) -> dict[str, torch.Tensor]:
    """Random clouds, half of each in either of two components."""
    make = torch.Generator().manual_seed(0)
    points = 0.05 * torch.rand(count, frames, 64, 3, generator=make)
    queries = 0.05 * torch.rand(count, frames, 128, 3, generator=make)
    return {
        "points": points,
        "point_labels": (points[..., 0] > 0.025).long(),
        "queries": queries,
        "query_labels": (queries[..., 0] > 0.025).long() + (queries[..., 1] > 0.025).long(),
        "tool_points": 0.05 * torch.rand(count, frames, 2, 32, 3, generator=make),
        "genus": torch.tensor([0, 1, -1, -1]).expand(count, frames, -1),
        "num_components": torch.full((count, frames), 2),
    }


def test_every_recipe_differs_in_one_decision() -> None:
    """`full` is the paper's; each other one has a single field of its own."""
    full = RECIPES["full"]
    for name, one in RECIPES.items():
        fields = ("steps", "explicit", "relative", "complete")
        differ = [f for f in fields if getattr(one, f) != getattr(full, f)]
        assert len(differ) == (name != "full")
    with pytest.raises(UnknownNameError, match="one-step"):
        recipe("two-step")


def test_relative_dynamics_add_to_what_was() -> None:
    """At first it copies; later the output is the normalised sum of the input and a change that
    is linear in the last layer."""
    torch.manual_seed(0)
    net = DoughNet(ModelConfig(**{**vars_of(NANO), "relative": True})).eval()
    z = net.dynamics.norm(torch.randn(2, 9, 24))
    tool = torch.randn(2, 9, 24)
    assert torch.allclose(net.dynamics(z, tool, tool), z, atol=1e-6)
    wanted = torch.randn(24)
    with torch.no_grad():
        net.dynamics.change.bias.copy_(wanted)
    assert torch.allclose(net.dynamics(z, tool, tool), net.dynamics.norm(z + wanted), atol=1e-6)


def vars_of(config: ModelConfig) -> dict:
    return {name: getattr(config, name) for name in ModelConfig.__dataclass_fields__}


def test_explicit_losses_reach_the_dynamics_through_the_decoder() -> None:
    """Shapes are compared, latents are not: the loss ignores what the later views show."""
    torch.manual_seed(0)
    stage = DynamicsStage(DoughNet(NANO), explicit=True)
    given = batch()
    one = stage(given, seed=0)
    assert one.keys() == {"loss", "masks", "genus"}
    changed = {**given, "points": given["points"].clone()}
    changed["points"][:, 1:] += 0.01
    assert torch.equal(stage(changed, seed=0)["masks"], one["masks"])
    one["loss"].backward()
    moved = [w.grad for w in stage.model.dynamics.parameters() if w.grad is not None]
    assert any(float(g.abs().sum()) > 0 for g in moved)
    frozen = stage.model.autoencoder.decoder.mask.weight
    assert frozen.grad is None
    latent = DynamicsStage(DoughNet(NANO))
    assert latent(given, seed=0).keys() == {"loss", "latent", "genus"}


def test_complete_points_lie_on_the_surfaces_in_proportion_to_area() -> None:
    """Two cubes whose areas are one to four: every point is on a face, one in five of the small."""

    def cube(side: float, x: float) -> ComponentMesh:
        import trimesh

        box = trimesh.creation.box(extents=[side] * 3)
        vertices = np.asarray(box.vertices + np.array([x, 0, 0]), np.float32)
        return ComponentMesh(vertices=vertices, faces=np.asarray(box.faces, np.uint32))

    meshes = (cube(0.01, -0.05), cube(0.02, 0.05))
    points, labels = complete_points(meshes, 5000, np.random.default_rng(0))
    for label, side, x in ((0, 0.01, -0.05), (1, 0.02, 0.05)):
        own = np.abs(points[labels == label] - [x, 0, 0])
        np.testing.assert_allclose(own.max(axis=1), side / 2, atol=1e-8)
    assert (labels == 1).mean() == pytest.approx(0.8, abs=0.03)
    nothing, none = complete_points((), 7, np.random.default_rng(0))
    assert (nothing == 0).all()
    assert (none == NO_POINT).all()


def test_the_complete_sensor_needs_no_camera(scenes: str) -> None:
    """Every key frame of every scene is served; points lie at the true surface, below as well."""
    data = DoughDataset(scenes, sensor="complete")
    source = data.source
    assert len(data) == len(source.scene_indices) * source.num_frames
    assert key_frames(source, "complete") == tuple(range(source.num_frames))
    sample = data[0]
    low = min(float(m.vertices[:, 2].min()) for m in source.frame(scene=0, frame=0).meshes)
    assert float(sample["points"][:, 2].min()) < low + 1e-3
    assert set(sample["point_labels"].tolist()) == set(range(int(sample["num_components"])))


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_every_recipe_trains_both_stages(scenes: str, tmp_path: Path, name: str) -> None:
    """And its weights say which it was."""
    fabric = new_fabric(accelerator="cpu", devices=1, precision="32-true")
    for stage in ("autoencoder", "dynamics"):
        config = RunConfig(
            dataset=scenes, out=tmp_path, preset="micro", recipe=name, sensor="none", epochs=1,
            loader=LoaderConfig(batch_size=2, workers=0),
        )  # fmt: skip
        train_stage(stage, config, fabric=fabric)
    weights = load_weights(tmp_path / "dynamics")
    assert weights.provenance["recipe"] == name
    assert weights.model.config.relative == RECIPES[name].relative
    seen = weights.provenance["data"]["sensor"]
    assert seen == ("complete" if RECIPES[name].complete else "none")
