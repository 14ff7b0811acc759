"""What the pipeline is asked for and what it answers."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from doughdata.scenes import FamilyName
from doughdata.stages import Mesher, Simulator, TopologyCheck

__all__ = ["FamilyScenes", "Listener", "Silent", "Stages", "Summary"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyScenes:
    """Scenes 0..count-1 of a family, for one root seed and split."""

    family: str  # a registered name, or name:argument (`mesh:bunny.stl`)
    count: int
    seed: int = 0
    split: str = "train"
    material: str | None = None  # a preset or `sampled`; None = the family's own

    @property
    def source(self) -> str:
        """Family and material in one text (`FamilyName`): what a plan is recorded under."""
        name = FamilyName.parse(self.family)
        return str(replace(name, material=self.material or name.material))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stages:
    """The stages to run, in this order; None = not now. Objects must be picklable."""

    simulator: Simulator | None = None
    check: TopologyCheck | None = None
    mesher: Mesher | None = None

    def by_layer(self) -> dict[str, tuple[str, Any]]:
        """Layer -> (plug-in kind, object), without the absent ones."""
        every = {
            "sim": ("simulators", self.simulator),
            "topology": ("topology", self.check),
            "mesh": ("meshers", self.mesher),
        }
        return {layer: pair for layer, pair in every.items() if pair[1] is not None}


class Listener(Protocol):
    """Hears how far a run is; the command line shows it as bars."""

    def start(self, stage: str, *, total: int, done: int) -> None:
        """A stage begins with `done` of its `total` scenes already committed."""
        ...

    def advance(self, stage: str, scenes: int) -> None:
        """More scenes of a stage are committed."""
        ...


class Silent:
    """A listener that says nothing."""

    def start(self, stage: str, *, total: int, done: int) -> None:
        """Ignore it."""

    def advance(self, stage: str, scenes: int) -> None:
        """Ignore it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a run did: per stage the scenes made now, and the ones kept from before."""

    dataset: str
    made: Mapping[str, int] = field(default_factory=dict)  # layer -> scenes
    kept: Mapping[str, int] = field(default_factory=dict)
    failed: Mapping[str, Mapping[int, str]] = field(default_factory=dict)  # layer -> scene: why

    def with_layer(
        self, layer: str, *, made: int, kept: int, failed: Mapping[int, str]
    ) -> "Summary":
        """The summary with one more layer."""
        return replace(
            self,
            made={**self.made, layer: made},
            kept={**self.kept, layer: kept},
            failed={**self.failed, layer: dict(failed)} if failed else self.failed,
        )

    def joined(self, other: "Summary") -> "Summary":
        """Both runs as one."""
        return replace(
            self,
            made={**self.made, **other.made},
            kept={**self.kept, **other.kept},
            failed={**self.failed, **other.failed},
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        failed = {k: {str(i): why for i, why in v.items()} for k, v in self.failed.items()}
        return {
            "dataset": self.dataset,
            "made": dict(self.made),
            "kept": dict(self.kept),
            "failed": failed,
        }

    def as_text(self) -> str:
        """A few lines for people."""
        lines = [f"dataset {self.dataset}"]
        for layer, made in self.made.items():
            kept = f", {self.kept[layer]} were there" if self.kept.get(layer) else ""
            lines.append(f"  {layer}: {made} scenes made{kept}")
            for scene, why in self.failed.get(layer, {}).items():
                lines.append(f"    scene {scene} failed: {why}")
        return "\n".join(lines)
