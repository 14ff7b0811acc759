"""Shapes whose occupancy is a formula: balls, boxes, capsules and tori, alone or in pairs.

They test whether the model learns at all, on any machine and without a dataset. A sample is what
`doughdata.torch` serves: a noisy partial view, queries with labels, genus. The view is ray-marched
through the shapes' own distance (Hart 1996), so that hidden parts are really hidden.

Legend: B batch, O objects (two places, the second often free), N points.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

__all__ = ["BOX", "Shapes", "random_shapes", "sample_batch", "stream"]

BALL, CUBOID, CAPSULE, TORUS = range(4)
PLACES = 2
BOX = ((-0.08, -0.08, 0.0), (0.08, 0.08, 0.06))  # [m]; holds all shapes
APART = 0.004  # [m] between the shapes of a pair, at least
PAIRS = 1 / 3  # share of scenes with two objects
PAIR_SCALE = 0.62  # of the shapes of a pair to one that is alone
CAMERA_DISTANCE = 0.4  # [m]
MARCH_STEPS = 18
HIT = 3e-4  # [m] from a surface that counts as on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Shapes:
    """A batch of scenes; lengths in [m], world. `size` means per kind: see `distance`."""

    kind: Int[Tensor, "B O"]
    size: Float[Tensor, "B O 3"]
    centre: Float[Tensor, "B O 3"]
    yaw: Float[Tensor, "B O"]
    present: Bool[Tensor, "B O"]

    @property
    def genus(self) -> Int[Tensor, "B O"]:
        """1 for a torus, 0 for the others, -1 for a free place."""
        return torch.where(self.present, (self.kind == TORUS).long(), -1)

    def distance(self, points: Float[Tensor, "B N 3"]) -> Float[Tensor, "B O N"]:
        """Signed distance [m] to each object, infinite for a free place.

        A ball has radius `size[0]`; a cuboid half edges `size`; a capsule radius `size[0]` and half
        length `size[1]` along y; a torus tube radius `size[0]` and ring radius `size[1]` about z.
        """
        local = points[:, None] - self.centre[:, :, None]
        cosine, sine = self.yaw.cos()[..., None], self.yaw.sin()[..., None]
        x = cosine * local[..., 0] + sine * local[..., 1]
        y = -sine * local[..., 0] + cosine * local[..., 1]
        z = local[..., 2]
        a, b, c = (self.size[..., k, None] for k in range(3))
        ball = (x * x + y * y + z * z).sqrt() - a
        edges = torch.stack([x.abs() - a, y.abs() - b, z.abs() - c], dim=-1)
        cuboid = edges.clamp(min=0).norm(dim=-1) + edges.amax(dim=-1).clamp(max=0)
        along = y - y.clamp(-b, b)
        capsule = (x * x + along * along + z * z).sqrt() - a
        ring = (x * x + y * y).sqrt() - b
        torus = (ring * ring + z * z).sqrt() - a
        every = torch.stack([ball, cuboid, capsule, torus], dim=0)
        index = self.kind[None, ..., None].expand(1, *ball.shape)
        distance = every.gather(0, index)[0]
        return torch.where(self.present[..., None], distance, torch.inf)

    def labels(self, points: Float[Tensor, "B N 3"]) -> Int[Tensor, "B N"]:
        """Object that holds each point; the number of objects = empty space."""
        nearest, which = self.distance(points).min(dim=1)
        return torch.where(nearest <= 0, which, self.present.sum(dim=1, keepdim=True))


def random_shapes(count: int, rng: torch.Generator) -> Shapes:
    """Scenes of one or two objects that lie on the table, within `BOX`, and do not touch."""

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=rng)

    kind = torch.randint(0, 4, (count, PLACES), generator=rng)
    present = torch.ones(count, PLACES, dtype=torch.bool)
    present[:, 1] = torch.rand(count, generator=rng) < PAIRS
    scale = torch.where(present[:, 1:], PAIR_SCALE, 1.0)
    small = scale * uniform(0.012, 0.017, count, PLACES)
    third = scale * uniform(0.012, 0.017, count, PLACES)
    large = scale * uniform(0.028, 0.040, count, PLACES)
    radius = scale * uniform(0.020, 0.028, count, PLACES)
    size = torch.stack([small, large, third], dim=-1)
    size[..., 0] = torch.where(kind == BALL, radius, small)
    height = torch.where(kind == CUBOID, third, size[..., 0])
    # Reach from the axis through the centre, for the worst direction.
    reach = torch.where(kind == BALL, radius, small + large)
    reach = torch.where(kind == CUBOID, (small**2 + large**2).sqrt(), reach)
    direction = uniform(0.0, 2 * math.pi, count)
    gap = reach.sum(dim=1) + APART + uniform(0.0, 0.006, count)
    offset = torch.stack([direction.cos(), direction.sin()], dim=-1) * gap[:, None]
    middle = uniform(-0.008, 0.008, count, 2)
    pair = present[:, 1, None]
    first = torch.where(pair, middle - offset / 2, middle)
    flat = torch.stack([first, middle + offset / 2], dim=1)
    centre = torch.cat([flat, height[..., None]], dim=-1)
    yaw = uniform(0.0, 2 * math.pi, count, PLACES)
    return Shapes(kind=kind, size=size, centre=centre, yaw=yaw, present=present)


def sample_batch(
    shapes: Shapes, rng: torch.Generator, *, num_points: int = 256, num_queries: int = 1024
) -> dict[str, Tensor]:
    """One view of each scene with queries, keyed as a sample of `doughdata.torch`."""
    hits, on_surface = _view(shapes, rng, 2 * num_points)
    weights = on_surface.float() + 1e-9
    chosen = torch.multinomial(weights, num_points, replacement=True, generator=rng)
    points = hits.gather(1, chosen[..., None].expand(-1, -1, 3))
    labels = shapes.distance(points).argmin(dim=1)
    queries = _queries(shapes, points, rng, num_queries)
    return {
        "points": points,
        "point_labels": labels,
        "queries": queries,
        "query_labels": shapes.labels(queries),
        "genus": shapes.genus,
        "num_components": shapes.present.sum(dim=1),
    }


def stream(seed: int, *, batch_size: int, step: int = 0) -> Iterator[dict[str, Tensor]]:
    """Batches without end, each drawn from (seed, step)."""
    while True:
        rng = torch.Generator().manual_seed(seed * 1_000_003 + step)
        yield sample_batch(random_shapes(batch_size, rng), rng)
        step += 1


def _view(
    shapes: Shapes, rng: torch.Generator, rays: int
) -> tuple[Float[Tensor, "B rays 3"], Bool[Tensor, "B rays"]]:
    """Where rays from a camera above end, and whether that is on a surface."""
    count = len(shapes.kind)
    azimuth = 2 * math.pi * torch.rand(count, generator=rng)
    elevation = math.radians(40) + math.radians(40) * torch.rand(count, generator=rng)
    flat = elevation.cos()
    camera = torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], dim=-1)
    camera = CAMERA_DISTANCE * camera[:, None]
    # Rays are aimed at the objects' bounding balls: most of them hit.
    which = torch.rand(count, rays, generator=rng) < 0.5
    which = (which & shapes.present[:, 1:]).long()
    index = which[..., None].expand(-1, -1, 3)
    spread = torch.randn(count, rays, 3, generator=rng) * 0.4
    reach = shapes.size.gather(1, index).sum(dim=-1, keepdim=True)
    target = shapes.centre.gather(1, index) + reach * spread
    direction = torch.nn.functional.normalize(target - camera, dim=-1)
    along = torch.full((count, rays, 1), CAMERA_DISTANCE - 0.12)
    for _ in range(MARCH_STEPS):
        gap = shapes.distance(camera + along * direction).amin(dim=1)
        along = along + gap[..., None].clamp(max=0.1)
    points = camera + along * direction
    return points, shapes.distance(points).amin(dim=1).abs() < HIT


def _queries(
    shapes: Shapes, points: Float[Tensor, "B N 3"], rng: torch.Generator, count: int
) -> Float[Tensor, "B count 3"]:
    """A third in the box, a third around the objects, a third about what is seen [m]."""
    batch, part = len(points), count // 3
    low, high = torch.tensor(BOX)
    everywhere = low + (high - low) * torch.rand(batch, count - 2 * part, 3, generator=rng)
    which = torch.randint(0, PLACES, (batch, part), generator=rng) * shapes.present[:, 1:]
    index = which[..., None].expand(-1, -1, 3)
    reach = shapes.size.amax(dim=-1, keepdim=True) + shapes.size.amin(dim=-1, keepdim=True)
    reach = reach.expand(-1, -1, 3).gather(1, index)
    reach = torch.cat([reach[..., :2], shapes.centre.gather(1, index)[..., 2:] * 1.2], dim=-1)
    around = torch.rand(batch, part, 3, generator=rng) * 2 - 1
    around = shapes.centre.gather(1, index) + reach * around
    seen = points[:, torch.randint(0, points.shape[1], (part,), generator=rng)]
    near = seen + 0.004 * torch.randn(batch, part, 3, generator=rng)
    return torch.cat([everywhere, around, near], dim=1)
