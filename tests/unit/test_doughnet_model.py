"""Shapes of the model against the paper, and the fast paths against the plain ones."""

import json
import math
from dataclasses import asdict

import pytest
import torch

from doughnet.autoencoder import input_labels
from doughnet.config import (
    PRESETS,
    ModelConfig,
    classic,
    config_from_json,
    micro,
    modern,
    paper,
    preset,
)
from doughnet.dynamics import Dynamics
from doughnet.folded import fold
from doughnet.hierarchical import decode_all, decode_labels
from doughnet.lattice import Lattice, workspace_lattice
from doughnet.model import DoughNet
from doughnet.nodes import NodeDecoder
from doughschemas import BadInputError, UnknownNameError

NANO = ModelConfig(latents=12, width=32, heads=2, encoder_depth=1, manipulator_depth=0,
                   dynamics_stacks=1)  # fmt: skip


def cloud(batch: int = 2, count: int = 64) -> tuple[torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(1)
    points = torch.rand(batch, count, 3, generator=rng) * 0.1 - 0.05
    return points, torch.randint(0, 4, (batch, count), generator=rng)


def test_paper_has_the_published_shapes() -> None:
    """257 x 512 latents, four stacks of two self- and one cross-attention over 257 x 1024, K + 1
    masks, and a genus head with an empty class, as the paper states them.
    """
    config = paper()
    model = DoughNet(config).eval()
    points, labels = cloud(1)
    with torch.inference_mode():
        latents = model.encode(points, labels)
        masks, genus = model.autoencoder.decoder(latents, points)
        tool = model.dynamics.embed_tool(points)
        after = model.dynamics(latents, tool, tool)
    assert latents.shape == tool.shape == after.shape == (1, 257, 512)
    assert masks.shape == (1, 64, config.components + 1)
    assert genus.shape == (1, config.components, config.max_genus + 2)
    assert len(model.dynamics.stacks) == 4
    for stack in model.dynamics.stacks:
        contexts = [block.attention.key.in_features for block in (stack.first, stack.second)]
        assert contexts == [512, 512]
        assert stack.first.context_norm is stack.second.context_norm is None
        assert stack.tool.attention.key.in_features == 1024
    assert model.autoencoder.encoder.queries.shape == (256, 512)
    assert model.autoencoder.decoder.queries.shape == (config.components + 1, 512)


def test_the_mean_token_is_the_mean_of_what_was_gathered() -> None:
    """Without self-attention, the last token is the others' mean before the final norm."""
    torch.manual_seed(0)
    config = ModelConfig(latents=7, width=16, heads=2, encoder_depth=0)
    encoder = DoughNet(config).autoencoder.encoder
    encoder.norm = torch.nn.Identity()
    points, labels = cloud()
    tokens = encoder(points, input_labels(labels, components=4))
    torch.testing.assert_close(tokens[:, -1], tokens[:, :-1].mean(dim=1))


def test_the_order_of_points_does_not_matter() -> None:
    """A permuted cloud has the same latents up to rounding, another label has not."""
    torch.manual_seed(0)
    model = DoughNet(NANO).eval()
    points, labels = cloud()
    order = torch.randperm(points.shape[1])
    there, back = model.encode(points, labels), model.encode(points[:, order], labels[:, order])
    torch.testing.assert_close(there, back, atol=1e-5, rtol=0)
    assert (there - model.encode(points, (labels + 1) % 4)).abs().max() > 1e-3


@pytest.mark.parametrize("values", [-1, 4, 255])
def test_padding_and_unknown_components_have_no_label(values: int) -> None:
    """Padding, components that have no mask and unlabelled points read as label 0."""
    labels = torch.full((3,), values)
    assert input_labels(labels, components=4).tolist() == [0, 0, 0]


def test_untrained_dynamics_copy_their_input() -> None:
    """Before training the next latents are the present ones, whatever the tool does."""
    torch.manual_seed(0)
    model = DoughNet(NANO)
    latents = model.encode(*cloud())
    tools = torch.randn(2, 4, 2, 8, 3)
    steps = model.rollout(latents, tools)
    assert steps.shape == (2, 3, NANO.tokens, NANO.width)
    torch.testing.assert_close(steps[:, -1], latents, atol=1e-3, rtol=0)


def test_a_rollout_is_step_after_step() -> None:
    """A step of a rollout is the dynamics on the step before, with the tool now and next."""
    torch.manual_seed(0)
    model = DoughNet(NANO)
    for parameter in model.dynamics.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    latents = model.encode(*cloud())
    tools = torch.randn(2, 3, 2, 8, 3) * 0.05
    embedded = [model.dynamics.embed_tool(tools[:, k].flatten(1, 2)) for k in range(3)]
    first = model.dynamics(latents, embedded[0], embedded[1])
    second = model.dynamics(first, embedded[1], embedded[2])
    torch.testing.assert_close(model.rollout(latents, tools), torch.stack([first, second], 1))
    assert (first - latents).abs().max() > 0.1


@pytest.mark.parametrize("make", [modern, classic])
@pytest.mark.parametrize("spread", [0.15, 0.4])
def test_folding_changes_nothing(make, spread: float) -> None:
    """The folded decoder's logits are the plain ones within rounding, for either norm."""
    torch.manual_seed(0)
    model = DoughNet(make(micro())).double().eval()
    for parameter in model.autoencoder.decoder.parameters():
        torch.nn.init.normal_(parameter, std=spread)
    points, labels = cloud()
    queries = torch.rand(2, 500, 3, dtype=torch.float64) * 0.2 - 0.1
    latents = model.encode(points.double(), labels)
    plain, genus = model.autoencoder.decoder(latents, queries)
    folded = fold(model.autoencoder.decoder, latents)
    torch.testing.assert_close(folded(queries), plain, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(folded.genus, genus)
    assert plain.std() > 1e-3


def test_folding_stays_precise_under_mixed_precision() -> None:
    """Where all else is computed in bfloat16, masks of given latents are those of float32."""
    torch.manual_seed(0)
    decoder = DoughNet(NANO).autoencoder.decoder
    latents, points = torch.randn(2, NANO.tokens, NANO.width), cloud()[0]
    folded = fold(decoder, latents)
    expected = folded(points)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(folded(points), expected)
        mixed = fold(decoder, latents)
        assert mixed.ask.dtype == torch.float32
        torch.testing.assert_close(mixed.ask, folded.ask)
        torch.testing.assert_close(mixed(points), expected, atol=0.05, rtol=0.05)


def test_folding_keeps_gradients() -> None:
    """Latents have the same gradient through the folded decoder as through the plain one."""
    torch.manual_seed(0)
    model = DoughNet(NANO).double()
    points, labels = cloud()
    latents = model.encode(points.double(), labels).detach().requires_grad_()
    queries = points.double()
    decoder = model.autoencoder.decoder
    (plain,) = torch.autograd.grad(decoder(latents, queries)[0].square().sum(), latents)
    (folded,) = torch.autograd.grad(fold(decoder, latents)(queries).square().sum(), latents)
    torch.testing.assert_close(folded, plain, rtol=1e-8, atol=1e-10)


def blobs(points: torch.Tensor) -> torch.Tensor:
    """Logits of two balls and a torus, none thinner than 8 mm, and empty space."""

    def ball(x: float, y: float, radius: float) -> torch.Tensor:
        return radius - (points - torch.tensor([x, y, 0.02])).norm(dim=-1)

    local = points - torch.tensor([-0.03, -0.03, 0.02])
    ring = local[..., :2].norm(dim=-1) - 0.02
    torus = 0.006 - (ring**2 + local[..., 2] ** 2).sqrt()
    inside = torch.stack([ball(0.04, 0.03, 0.02), ball(0.04, -0.01, 0.018), torus], dim=-1)
    return torch.cat([inside, torch.zeros_like(inside[..., :1])], dim=-1)


def at_nodes(decoder):
    """A decoder of points as one of nodes."""

    def on(lattice: Lattice):
        corner = torch.tensor(lattice.first)

        def logits(*index: torch.Tensor) -> torch.Tensor:
            nodes = torch.stack(torch.broadcast_tensors(*index), dim=-1)
            return decoder(lattice.spacing * (corner + nodes))

        return logits

    return on


@pytest.mark.parametrize("strides", [(4, 2), (2,)])
def test_coarse_to_fine_finds_every_node(strides: tuple[int, ...]) -> None:
    """On shapes thicker than a coarse cell the hierarchy gives every node its plain label, and it
    asks for a small part of them.
    """
    asked = 0

    def counted(points: torch.Tensor) -> torch.Tensor:
        nonlocal asked
        asked += points[..., 0].numel()
        return blobs(points)

    lattice = Lattice(first=(-71, -70, 0), shape=(143, 141, 47))  # no whole number of cells
    found = decode_labels(at_nodes(counted), lattice, strides=strides)
    assert torch.equal(found, decode_all(at_nodes(blobs), lattice))
    assert set(found.unique().tolist()) == {0, 1, 2, 3}
    assert asked < 0.25 * lattice.count


def test_a_lattice_without_dough_is_empty() -> None:
    """Where every node is empty, nothing is refined and every label says so."""
    lattice = Lattice(first=(-9, -9, 0), shape=(19, 18, 10))
    nothing = at_nodes(lambda points: torch.tensor([0.0, 1.0]).expand(*points.shape[:-1], 2))
    assert torch.equal(
        decode_labels(nothing, lattice), torch.ones(lattice.shape, dtype=torch.uint8)
    )


@pytest.mark.parametrize("make", [modern, classic])
def test_tables_change_nothing(make) -> None:
    """Look-ups along the axes give every node the plain decoder's logits, one by one and spread
    over the axes alike.
    """
    torch.manual_seed(0)
    model = DoughNet(make(NANO)).eval()
    for parameter in model.autoencoder.decoder.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    lattice = Lattice(first=(-20, 5, 0), shape=(30, 20, 10), spacing=3e-3)
    with torch.inference_mode():
        latents = model.encode(*cloud())
        decoder = NodeDecoder(fold(model.autoencoder.decoder, latents), lattice, shape=1)
        flat = torch.arange(lattice.count)
        plain, _ = model.autoencoder.decoder(latents[1:], lattice.points(flat)[None])
        found = decoder(*torch.unravel_index(flat, lattice.shape))
        x, y, z = (torch.arange(n) for n in lattice.shape)
        spread = decoder(x[:, None, None], y[:, None], z)
    assert plain.std() > 0.03
    torch.testing.assert_close(found, plain[0], rtol=0, atol=1e-5)
    torch.testing.assert_close(spread.flatten(0, 2), found, rtol=1e-5, atol=1e-5)


def test_lattice_points_are_multiples_of_the_spacing() -> None:
    """The workspace lattice runs from corner to corner in whole millimetres, table included."""
    lattice = workspace_lattice()
    points = lattice.points(torch.tensor([0, lattice.count - 1]))
    expected = torch.tensor([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.06]])
    torch.testing.assert_close(points, expected, atol=1e-7, rtol=0)
    assert lattice.count == 201 * 201 * 61


def test_inference_at_a_millimetre_gives_components_of_the_head() -> None:
    """Labels of masks that the head calls empty become dough of no component, others count up."""
    from doughnet.metrics import UNASSIGNED
    from doughnet.model import Shape

    labels = torch.tensor([[[0, 1, 2, 3, 4]]], dtype=torch.uint8)
    shape = Shape(labels=labels, genus=(None, 1, None, 0))
    found, genus = shape.components()
    assert genus == [1, 0]
    assert found.flatten().tolist() == [UNASSIGNED, 0, UNASSIGNED, 1, 2]
    assert not shape.consistent
    assert Shape(labels=labels[..., [1, 3, 4]], genus=(None, 1, None, 0)).consistent


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_json(name: str) -> None:
    """Every preset is read back from its own JSON, and `modern` costs what `classic` costs."""
    config = preset(name)
    assert config_from_json(json.loads(json.dumps(asdict(config)))) == config
    sizes = [
        sum(p.numel() for p in DoughNet(make(NANO)).parameters()) for make in (modern, classic)
    ]
    assert math.isclose(*sizes, rel_tol=0.05)


def test_wrong_names_and_sizes_are_told() -> None:
    """An unknown preset, an unknown field and an impossible width are errors that say so."""
    with pytest.raises(UnknownNameError, match="did you mean 'micro'"):
        preset("mirco")
    with pytest.raises(BadInputError, match="this release"):
        config_from_json({"colour": 1})
    with pytest.raises(BadInputError, match="multiple of 8 heads"):
        ModelConfig(width=100)
    with pytest.raises(BadInputError, match="norm must be one of"):
        ModelConfig(norm="batch")


def test_dynamics_see_the_tool_through_their_own_encoder() -> None:
    """Training the dynamics moves no weight of the autoencoder's encoder."""
    model = DoughNet(NANO)
    own = {id(p) for p in model.dynamics.parameters()}
    assert isinstance(model.dynamics, Dynamics)
    assert not own & {id(p) for p in model.autoencoder.parameters()}
