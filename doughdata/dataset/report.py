"""What `validate` found."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Problem", "Report"]

SHOWN = 8  # frames that a message lists before it counts the rest


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """Something that is wrong, and where."""

    file: str  # path in the dataset, or a layer's folder
    message: str
    frames: tuple[tuple[int, int], ...] = ()  # (scene_index, frame_index) of the key frames it hits

    def __str__(self) -> str:
        text = f"{self.file}: {self.message}"
        if not self.frames:
            return text
        shown = ", ".join(f"scene {scene} frame {frame}" for scene, frame in self.frames[:SHOWN])
        more = len(self.frames) - SHOWN
        return f"{text} [{shown}{f' and {more} more' if more > 0 else ''}]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Problems make a dataset invalid; figures only inform."""

    problems: tuple[Problem, ...]
    figures: Mapping[str, Any]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for `--json`."""
        problems = [
            {
                "file": problem.file,
                "message": problem.message,
                "frames": [{"scene_index": s, "frame_index": f} for s, f in problem.frames],
            }
            for problem in self.problems
        ]
        return {"ok": self.ok, "problems": problems, "figures": dict(self.figures)}
