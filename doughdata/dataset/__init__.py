"""The dataset on disk: writer, reader, derived tables, validation.

Writing: `open_writer` -> `plan_family` or `plan_scenes` -> `tasks` -> `write` -> `refresh`.
Reading: `open_dataset`. Nothing here needs more than numpy, pyarrow and zarr.
"""

from doughdata.dataset.commits import CommitRecord, StageRecord
from doughdata.dataset.frame import Frame, FrameParticles, FrameTools
from doughdata.dataset.info import DatasetSettings, default_scenes_per_shard
from doughdata.dataset.plan import PlanRecord, Shard
from doughdata.dataset.reader import Dataset, open_dataset
from doughdata.dataset.report import Problem, Report
from doughdata.dataset.tasks import Earlier, Task
from doughdata.dataset.validate import validate
from doughdata.dataset.writer import DatasetWriter, open_writer

__all__ = [
    "CommitRecord",
    "Dataset",
    "DatasetSettings",
    "DatasetWriter",
    "Earlier",
    "Frame",
    "FrameParticles",
    "FrameTools",
    "PlanRecord",
    "Problem",
    "Report",
    "Shard",
    "StageRecord",
    "Task",
    "default_scenes_per_shard",
    "open_dataset",
    "open_writer",
    "validate",
]
