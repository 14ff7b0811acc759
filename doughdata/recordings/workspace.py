"""From depth images to labelled dough in a world that stands on the table."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from doughdata.geometry import quaternion_to_matrix, transform_points
from doughdata.recordings.dough import Dough, check_expected, find_dough, rolls_turn
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.options import ProcessingConfig
from doughdata.recordings.table import Plane, camera_points, fit_table, world_camera
from doughschemas import SEGMENT_COMPONENT, SEGMENT_NONE, SEGMENT_TABLE, Camera, Intrinsics

__all__ = ["LabelledFrame", "Workspace", "set_up"]

Image = UInt8[np.ndarray, "rows columns"]
Mask = Bool[np.ndarray, "rows columns"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledFrame:
    """What the steps made of one frame; masks are kept for the contact sheet."""

    segments: Image  # SEGMENT_* of doughschemas
    heights: Float64[np.ndarray, "rows columns"]  # [m], NaN where depth is invalid
    band: Mask  # within the height band
    coloured: Mask  # of the wanted colour; all without one
    candidates: Mask
    dough: Dough
    points: Float64[np.ndarray, "points 3"]  # [m], world, of the candidates


@dataclass(slots=True, kw_only=True)
class Workspace:
    """The fixed camera over the table. Figures of all labelled frames add up."""

    camera: Camera
    plane: Plane
    turn: float  # [rad], of the world about z against the picture
    config: ProcessingConfig
    table: Mask  # table pixels of the first frame
    empty: int = 0  # frames without dough
    drift: float = 0.0  # [m], largest median distance of those pixels from the table
    moved: int = 0  # frames in which it was more than `table_drift`
    pieces: list[int] = field(default_factory=list)  # in each frame

    def label(
        self,
        depth: Float64[np.ndarray, "rows columns"],
        color: UInt8[np.ndarray, "rows columns 3"] | None,
    ) -> LabelledFrame:
        """Label a frame [m]; pieces are numbered by x, then y, of their middle in the world."""
        points = camera_points(depth, self.camera.intrinsics)
        heights = np.where(depth > 0, self.plane.heights(points), np.nan)
        band, coloured = _masks(heights, color, self.config)
        candidates = band & coloured
        position, quaternion = np.array(self.camera.position), np.array(self.camera.quaternion)
        world = transform_points(points[candidates], position, quaternion)
        dough = find_dough(world, self.config)
        segments = np.full(depth.shape, SEGMENT_NONE, np.uint8)
        segments[np.abs(heights) <= self.config.plane_distance] = SEGMENT_TABLE
        labelled = segments[candidates]
        labelled[dough.labels >= 0] = SEGMENT_COMPONENT + dough.labels[dough.labels >= 0]
        segments[candidates] = labelled
        self._count(dough, heights)
        return LabelledFrame(
            segments=segments,
            heights=heights,
            band=band,
            coloured=coloured,
            candidates=candidates,
            dough=dough,
            points=world,
        )

    def warnings(self) -> list[str]:
        """Lines for the user about all frames so far."""
        lines = []
        if self.moved:
            lines.append(
                f"the table is off by up to {self.drift * 1e3:.0f} mm in {self.moved} frames: the "
                "camera moved, but the pose of the first frame is used for all"
            )
        if self.empty:
            lines.append(f"no dough was found in {self.empty} of {len(self.pieces)} frames")
        if self.pieces and self.pieces[0] > 1 and self.config.expect is None:
            lines.append(
                f"{self.pieces[0]} pieces stand on the table in the first frame; --expect says "
                "what must be there, --color picks the dough"
            )
        return lines

    def figures(self) -> dict[str, Any]:
        """Plane, pose and pieces, for provenance."""
        tilt = np.degrees(np.arccos(np.clip(-self.plane.normal[2], -1, 1)))
        return {
            "camera_height": self.plane.offset,
            "camera_tilt_degrees": float(tilt),  # optical axis against straight down
            "plane_share": self.plane.share,
            "plane_residual": self.plane.residual,
            "turn_degrees": float(np.degrees(self.turn)),
            "table_drift": self.drift,
            "pieces_first": self.pieces[0] if self.pieces else 0,
            "pieces_last": self.pieces[-1] if self.pieces else 0,
            "frames_without_dough": self.empty,
        }

    def _count(self, dough: Dough, heights: Float64[np.ndarray, "rows columns"]) -> None:
        self.pieces.append(dough.num_pieces)
        self.empty += dough.num_pieces == 0
        seen = np.abs(heights[self.table & np.isfinite(heights)])
        off = float(np.median(seen)) if len(seen) else 0.0
        self.drift = max(self.drift, off)
        self.moved += off > self.config.table_drift


def set_up(
    depth: Float64[np.ndarray, "rows columns"],
    color: UInt8[np.ndarray, "rows columns 3"] | None,
    intrinsics: Intrinsics,
    config: ProcessingConfig,
    *,
    plane: Plane | None = None,
) -> Workspace:
    """Find table and dough in the first frame [m] and put the world's origin under the dough.

    Args:
        depth: first frame, 0 = invalid.
        color: its colour image, if there is one.
        intrinsics: of the camera.
        config: numbers of all steps.
        plane: the table, where it is known; None = the largest plane.

    Raises:
        RecordingError: no table, no dough, or not the pieces that are expected.
    """
    points = camera_points(depth, intrinsics)
    plane = fit_table(points, depth > 0, config) if plane is None else plane
    heights = np.where(depth > 0, plane.heights(points), np.nan)
    band, coloured = _masks(heights, color, config)
    chosen = points[band & coloured]
    if len(chosen) == 0:
        raise RecordingError(_nothing(band, coloured, config))
    rough = world_camera(intrinsics, plane, chosen.mean(axis=0), 0.0)
    position, quaternion = np.array(rough.position), np.array(rough.quaternion)
    dough = find_dough(transform_points(chosen, position, quaternion), config)
    if dough.num_pieces == 0:
        raise RecordingError(_nothing(band, coloured, config))
    check_expected(dough, config.expect)
    turn = rolls_turn(dough.voxels, dough.pieces) if config.expect == "rolls" else 0.0
    # The middle on the table, back in the optical frame.
    origin = (np.append(_middle(dough), 0.0) - position) @ quaternion_to_matrix(quaternion)
    return Workspace(
        camera=world_camera(intrinsics, plane, origin, turn),
        plane=plane,
        turn=turn,
        config=config,
        table=np.abs(heights) <= config.plane_distance,
    )


def _masks(
    heights: Float64[np.ndarray, "rows columns"],
    color: UInt8[np.ndarray, "rows columns 3"] | None,
    config: ProcessingConfig,
) -> tuple[Mask, Mask]:
    """Pixels in the height band, and pixels of the wanted colour."""
    with np.errstate(invalid="ignore"):
        band = (heights >= config.height_min) & (heights <= config.height_max)
    if config.color is None:
        return band, np.ones(band.shape, bool)
    if color is None:
        raise RecordingError("--color needs colour images, and this recording has none in use")
    return band, config.color.holds(color)


def _middle(dough: Dough) -> Float64[np.ndarray, " 2"]:
    """Middle of one piece's box on the table [m]; of several, the middle between their means."""
    pieces = [dough.voxels[dough.pieces == k, :2] for k in range(dough.num_pieces)]
    if len(pieces) == 1:
        return (pieces[0].min(axis=0) + pieces[0].max(axis=0)) / 2
    return np.mean([piece.mean(axis=0) for piece in pieces], axis=0)


def _nothing(band: Mask, coloured: Mask, config: ProcessingConfig) -> str:
    """Why there is no dough, and what to try."""
    low, high = config.height_min * 1e3, config.height_max * 1e3
    if not band.any():
        return f"nothing stands {low:g} to {high:g} mm above the table: try --height-min"
    if not (band & coloured).any():
        return (
            f"no pixel of --color lies {low:g} to {high:g} mm above the table ({coloured.sum()} "
            "have the colour, at other heights): try a wider range; a recording whose red and blue "
            "are exchanged (bgr8 called rgb8) looks like this as well"
        )
    return (
        f"only scattered points lie {low:g} to {high:g} mm above the table "
        f"({(band & coloured).sum()} pixels): try --height-min or --color"
    )
