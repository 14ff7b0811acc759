"""What a user may say about a recording and how it is processed; one frozen record each."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from doughdata.recordings.colour import ColourRange
from doughschemas import BadInputError, Intrinsics

__all__ = ["EXPECTED", "ProcessingConfig", "TopicOptions"]

# What `--expect` may name -> components that the first key frame must show.
EXPECTED = {"rolls": 2, "doughnut": 1, "roll": 1, "ball": 1, "pretzel": 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicOptions:
    """Which messages are used; None = found by type and name."""

    depth_topic: str | None = None
    color_topic: str | None = None  # "none" leaves colour out
    info_topic: str | None = None
    gripper_topic: str | None = None  # TOPIC or TOPIC:FIELD; of JointState a joint's name
    gripper_scale: float | None = None  # [m per unit]; None = metres, WSG drivers millimetres
    tool_frame: str | None = None  # tf frame of the gripper
    intrinsics: Intrinsics | None = None  # instead of a camera_info topic
    depth_scale: float | None = None  # [m per unit] of 16-bit depth; None = millimetres
    every: int = 1  # take every n-th frame
    frames: int | None = None  # key frames, uniform in time; None = all

    def __post_init__(self) -> None:
        """Refuse numbers that mean nothing."""
        if self.every < 1 or (self.frames is not None and self.frames < 1):
            raise BadInputError("every and frames must be at least 1")
        for name in ("depth_scale", "gripper_scale"):
            value = getattr(self, name)
            if value is not None and not 0 < value < 1e3:
                raise BadInputError(f"{name} must be metres per unit, above 0, got {value}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessingConfig:
    """Every number of the steps from a depth image to labelled dough. Lengths in [m]."""

    table: Literal["fit", "given"] = "fit"  # given: z is up and the table is z = 0 already
    plane_distance: float = 0.004  # a point this close to the plane is the table's
    plane_draws: int = 1000  # RANSAC
    plane_points: int = 60_000  # at most so many pixels are used to fit
    table_drift: float = 0.004  # the camera has moved if the table is off by more
    height_min: float = 0.005  # dough lies between these heights above the table
    height_max: float = 0.150
    color: ColourRange | None = None  # None: whatever stands on the table
    outlier_neighbours: int = 30  # statistical outlier removal: a point whose mean distance to so
    outlier_ratio: float = 2.0  # many neighbours is this many deviations above the mean goes
    voxel: float = 0.002
    cluster_distance: float = 0.010  # voxels closer than this are one piece
    cluster_share: float = 0.05  # a smaller share of all voxels is a crumb
    expect: str | None = None  # see EXPECTED

    def __post_init__(self) -> None:
        """Refuse numbers that cannot work."""
        if self.expect is not None and self.expect not in EXPECTED:
            raise BadInputError(f"expect must be one of {', '.join(EXPECTED)}, got {self.expect!r}")
        if not 0 <= self.height_min < self.height_max:
            raise BadInputError(
                f"height_min must be below height_max, got {self.height_min} and {self.height_max}"
            )
        positive = ("plane_distance", "voxel", "cluster_distance", "outlier_ratio", "table_drift")
        for name in positive:
            if not getattr(self, name) > 0:
                raise BadInputError(f"{name} must be above 0, got {getattr(self, name)}")

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        return asdict(self)
