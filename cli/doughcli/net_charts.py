"""Pictures of an analysis, one file each."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from doughcli.net_surfaces import from_above
from doughdata.registry import require_package
from doughdata.view.panels import COLOURS
from doughschemas import BadInputError

__all__ = ["Charts"]

METRICS = ("viou", "ciou", "accc", "accg")


class Charts:
    """Draws into a folder, which is made.

    Raises:
        BadInputError: the folder cannot be made.
        MissingPackageError: matplotlib is not installed.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._figure = require_package("matplotlib.figure", extra="view").Figure
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInputError(f"cannot make {folder}: {error.strerror or error}") from error

    def write_json(self, found: dict[str, Any]) -> None:
        """`analysis.json`."""
        self._save_text("analysis.json", json.dumps(found, indent=1, allow_nan=False) + "\n")

    def curves(self, changes: Any) -> None:
        """`roc.png` and `precision_recall.png` of a `doughnet.analysis.changes.Detector`."""
        figure = self._figure(figsize=(4, 4), layout="constrained")
        axis = figure.add_subplot(xlabel="false-positive rate", ylabel="true-positive rate")
        axis.plot(changes.false_positive_rate, changes.true_positive_rate, color="#c4512d")
        axis.plot([0, 1], [0, 1], color="#999999", ls="--", lw=1)
        axis.set_title(f"changes of topology, area {changes.area:.3f}")
        self._save("roc.png", figure)
        figure = self._figure(figsize=(4, 4), layout="constrained")
        axis = figure.add_subplot(xlabel="recall", ylabel="precision", ylim=(0, 1.02))
        axis.plot(changes.recall, changes.precision, color="#c4512d")
        axis.axhline(changes.positive_rate / 100, color="#999999", ls="--", lw=1)
        axis.set_title(f"best F1 {changes.f1:.1f} % at z = {changes.threshold:.2f}")
        self._save("precision_recall.png", figure)

    def embedding(self, places: np.ndarray, latents: Sequence[Any]) -> None:
        """`tsne.png`: the same places by family, by sequence and by topology."""
        figure = self._figure(figsize=(13, 4.4), layout="constrained")
        axes = figure.subplots(1, 3)
        family = np.concatenate([[own.family] * len(own.frames) for own in latents])
        topology = np.concatenate([[_name(genus) for genus in own.genus] for own in latents])
        for axis, names, title in ((axes[0], family, "family"), (axes[2], topology, "topology")):
            for number, name in enumerate(sorted(set(names.tolist()))):
                own = places[names == name]
                colour = COLOURS[number % len(COLOURS)]
                axis.scatter(*own.T, s=6, color=colour, label=name, linewidths=0)
            axis.legend(fontsize=7, markerscale=2)
            axis.set_title(title)
        start = 0
        for number, own in enumerate(latents):
            line = places[start : start + len(own.frames)]
            axes[1].plot(*line.T, lw=0.8, color=COLOURS[number % len(COLOURS)])
            axes[1].scatter(*line[0], s=12, color="black", zorder=3, linewidths=0)
            start += len(own.frames)
        axes[1].set_title("sequence, from the dot on")
        for axis in axes:
            axis.set(xticks=[], yticks=[])
        self._save("tsne.png", figure)

    def errors(self, errors: Any) -> None:
        """`errors.png`: the figures of every step, and how first mistakes are corrected."""
        figure = self._figure(figsize=(9, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        for number, name in enumerate(METRICS):
            values = [row[name] for row in errors.by_step]
            left.plot(values, label=name, color=COLOURS[number % len(COLOURS)], marker=".")
        left.set(xlabel="step (0 = reconstruction of the first view)", ylabel="percent")
        left.legend()
        right.plot(errors.corrected, color="#c4512d", marker=".")
        title = f"right topology in the {errors.first_wrong} scenes that begin wrong"
        right.set(xlabel="step", ylabel="percent", ylim=(-2, 102), title=title)
        self._save("errors.png", figure)

    def scales(self, source: Any) -> None:
        """`scales.png`: how large bodies and how wide tools of the splits are."""
        figure = self._figure(figsize=(5, 4), layout="constrained")
        axis = figure.add_subplot(
            xlabel="largest side of a body [mm]", ylabel="width of a finger [mm]"
        )
        splits = source.scenes["split"].to_pylist()
        regions = source.scenes["region"].to_pylist()
        indices = source.scenes["scene_index"].to_pylist()
        kinds = [f"{split}, {region}" for split, region in zip(splits, regions, strict=True)]
        for number, kind in enumerate(sorted(set(kinds))):
            own = [k for k, name in zip(indices, kinds, strict=True) if name == kind]
            sizes = np.array([_sizes(source.scene(k)) for k in own]) * 1000
            axis.scatter(*sizes.T, s=10, label=kind, color=COLOURS[number % len(COLOURS)])
        axis.set_yscale("log")
        axis.legend(fontsize=7)
        self._save("scales.png", figure)

    def failures(self, model: Any, sequences: Any, failures: Sequence[Any]) -> None:
        """`failures.png`: the worst frames from above, truth beside prediction."""
        if not failures:
            return
        figure = self._figure(figsize=(2 * len(failures), 4.4), layout="constrained")
        axes = figure.subplots(2, len(failures), squeeze=False)
        for column, one in zip(axes.T, failures, strict=True):
            true, predicted = _from_above(model, sequences, one)
            pairs = zip(column, (true, predicted), ("true", "predicted"), strict=True)
            for axis, picture, name in pairs:
                genus = one.true if name == "true" else one.predicted
                axis.imshow(picture.transpose(1, 0, 2), origin="lower")
                axis.set(xticks=[], yticks=[])
                axis.set_title(f"{name} g={list(genus)}", fontsize=7)
            column[0].set_xlabel(
                f"scene {one.scene_index}, key frame {one.frame_index}", fontsize=7
            )
        self._save("failures.png", figure)

    def _save(self, name: str, figure: Any) -> None:
        try:
            figure.savefig(self.folder / name, dpi=110)
        except OSError as error:
            path = self.folder / name
            raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error

    def _save_text(self, name: str, text: str) -> None:
        path = self.folder / name
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BadInputError(f"cannot write {path}: {error.strerror or error}") from error


def _name(genus: Sequence[int]) -> str:
    return f"c={len(genus)}, g={','.join(map(str, genus))}"


def _sizes(scene: Any) -> tuple[float, float]:
    """Largest side of a body and width of a finger [m]."""
    from doughdata.scenes.shapes import shape_of

    sides = [np.ptp(shape_of(body).bounds(), axis=0).max() for body in scene.bodies]
    return float(max(sides)), scene.tools[0].width


def _from_above(model: Any, sequences: Any, one: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pictures of the topmost components, true and predicted from the first view."""
    from doughnet.lattice import on_lattice, workspace_lattice
    from doughnet.predict import predict

    lattice = workspace_lattice()
    frame = sequences.source.frame(scene=one.scene_index, frame=one.frame_index)
    true = on_lattice(frame.label_grid, lattice)
    prediction = predict(model, sequences.source, scene=one.scene_index, sensor=sequences.sensor)
    shape = next(f.shape for f in prediction.frames if f.frame_index == one.frame_index)
    labels, genus = shape.components()
    return _picture(true, len(frame.genus)), _picture(labels.numpy(), len(genus))


def _picture(labels: np.ndarray, count: int) -> np.ndarray:
    seen = from_above(labels, count)
    colours = COLOURS[seen % len(COLOURS)][..., :3]
    return np.where((seen >= 0)[..., None], colours, 1.0)
