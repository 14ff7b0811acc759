"""Sizes of the model. A variant is a function; JSON is only recorded provenance.

Where the paper is silent, `paper` follows the authors' public configuration: two self-attention
blocks in the encoder, four components and the outliers, genus 0 to 2 and *empty*.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from doughschemas import BadInputError, UnknownNameError

__all__ = [
    "PRESETS",
    "ModelConfig",
    "classic",
    "config_from_json",
    "micro",
    "modern",
    "paper",
    "preset",
    "small",
    "tiny",
]

NORMS, GATES = ("layer", "rms"), ("gelu", "silu")


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelConfig:
    """Sizes and kinds of all parts; the paper's by default."""

    latents: int = 256  # learned queries; one mean token comes on top
    width: int = 512  # channels of a latent
    heads: int = 8  # of every attention but the decoder's, which has one
    encoder_depth: int = 2  # self-attention blocks after the aggregation
    manipulator_depth: int = 2  # the same in the encoder of the tool
    dynamics_stacks: int = 4  # of two self- and one cross-attention block each
    components: int = 4  # K: masks beside the one of the outliers
    max_genus: int = 2  # a higher genus counts as this one
    frequencies: int = 8  # of the Fourier features
    norm: str = "layer"  # layer | rms
    gate: str = "gelu"  # activation of the gated feed-forward: gelu | silu
    expansion: float = 4.0  # hidden width of the feed-forward, in widths
    query_key_norm: bool = False  # RMS norm of queries and keys in each head
    relative: bool = False  # dynamics predict the change of the latents (an ablation)
    scale: float = 0.1  # [m] that becomes 1 before the Fourier features

    def __post_init__(self) -> None:
        if self.norm not in NORMS or self.gate not in GATES:
            raise BadInputError(
                f"norm must be one of {NORMS} and gate one of {GATES}, "
                f"got {self.norm!r} and {self.gate!r}"
            )
        if self.width % self.heads:
            raise BadInputError(f"width {self.width} is not a multiple of {self.heads} heads")

    @property
    def tokens(self) -> int:
        """Latent codes of a shape: the learned queries and their mean."""
        return self.latents + 1

    @property
    def input_labels(self) -> int:
        """One-hot length of a point's label: 0 = none or tool, component k = k + 1."""
        return self.components + 1

    @property
    def genus_classes(self) -> int:
        """Classes of the genus head: genus 0 .. max_genus, then *empty*."""
        return self.max_genus + 2

    @property
    def empty_class(self) -> int:
        """Index of the class *empty*."""
        return self.max_genus + 1

    @property
    def outlier_mask(self) -> int:
        """Index of the mask of empty space."""
        return self.components


def modern(config: ModelConfig) -> ModelConfig:
    """The same sizes with RMS norm, SwiGLU at equal cost, and normalised queries and keys."""
    return replace(config, norm="rms", gate="silu", expansion=8 / 3, query_key_norm=True)


def classic(config: ModelConfig) -> ModelConfig:
    """The same sizes with the paper's blocks, to compare."""
    return replace(config, norm="layer", gate="gelu", expansion=8 / 3, query_key_norm=False)


def paper() -> ModelConfig:
    """257 x 512 latents and four stacks, as published."""
    return ModelConfig()


def small() -> ModelConfig:
    """129 x 256 latents."""
    sizes = ModelConfig(latents=128, width=256, heads=4, encoder_depth=6, dynamics_stacks=3)
    return modern(replace(sizes, manipulator_depth=0))


def tiny() -> ModelConfig:
    """65 x 128 latents."""
    sizes = ModelConfig(latents=64, width=128, heads=4, encoder_depth=4, dynamics_stacks=2)
    return modern(replace(sizes, manipulator_depth=0))


def micro() -> ModelConfig:
    """49 x 96 latents: learns in minutes on one CPU core."""
    sizes = ModelConfig(latents=48, width=96, heads=4, encoder_depth=3, dynamics_stacks=2)
    return modern(replace(sizes, manipulator_depth=0))


PRESETS: Mapping[str, Callable[[], ModelConfig]] = {
    "paper": paper,
    "paper-modern": lambda: modern(paper()),
    "small": small,
    "small-classic": lambda: classic(small()),
    "tiny": tiny,
    "tiny-classic": lambda: classic(tiny()),
    "micro": micro,
    "micro-classic": lambda: classic(micro()),
}


def preset(name: str) -> ModelConfig:
    """The preset of a name.

    Raises:
        UnknownNameError: no such preset; the message lists the known ones.
    """
    if name not in PRESETS:
        raise UnknownNameError("model preset", name, PRESETS)
    return PRESETS[name]()


def config_from_json(data: Mapping[str, Any]) -> ModelConfig:
    """The config of plain JSON, as weights carry it.

    Raises:
        BadInputError: a field that this release does not know.
    """
    try:
        return ModelConfig(**data)
    except TypeError as error:
        raise BadInputError(f"not a model config of this release: {error}") from error
