"""What a training run leaves to read: one row of a CSV file a record, and TensorBoard's curves."""

import csv
from collections.abc import Mapping
from pathlib import Path

from doughnet.extras import train_package

__all__ = ["Journal"]

NAME = "metrics.csv"


class Journal:
    """Appends records; a run that was resumed drops what it had written after its checkpoint."""

    def __init__(self, folder: Path, *, step: int = 0) -> None:
        self._path = folder / NAME
        folder.mkdir(parents=True, exist_ok=True)
        if self._path.exists():
            self._keep_before(step)
        tensorboard = train_package("torch.utils.tensorboard")
        self._curves = tensorboard.SummaryWriter(str(folder / "tensorboard"), purge_step=step)

    def record(self, step: int, values: Mapping[str, float]) -> None:
        """One row of numbers at a step; all records of a run have the same names."""
        new = not self._path.exists()
        with self._path.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["step", *values])
            writer.writerow([step, *(f"{value:.6g}" for value in values.values())])
        for name, value in values.items():
            self._curves.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush the curves."""
        self._curves.close()

    def _keep_before(self, step: int) -> None:
        with self._path.open(newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
        # A row cut short by a crash goes, too.
        kept = [row for row in rows if len(row) == len(header) and int(row[0]) <= step]
        if not kept:
            self._path.unlink()
            return
        with self._path.open("w", newline="") as file:
            csv.writer(file).writerows([header, *kept])
