"""Hugging Face `datasets`: a folder of Parquet that `load_dataset(folder)` opens with its features.

One row a key frame: gripper, topology, particles with labels, and depth and segments as PNG.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset import Dataset, Frame
from doughdata.exporters.folders import new_folder
from doughdata.exporters.rows import (
    STATE_NAMES,
    Image,
    chosen_sensors,
    image_names,
    png,
    rows_of,
    scene_images,
    scene_splits,
    scene_states,
)
from doughschemas import BadInputError, MissingLayerError

__all__ = ["HuggingFace"]

FILE_BYTES = 256 * 2**20  # a Parquet file is closed when its scenes have this size
INTS, VECTORS = pa.list_(pa.int32()), pa.list_(pa.list_(pa.float32(), 3))
IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
COLUMNS = [
    ("scene_index", pa.int64()),
    ("frame_index", pa.int32()),
    ("timestamp", pa.float64()),
    ("scene_id", pa.string()),
    ("family", pa.string()),
    ("split", pa.string()),
    ("region", pa.string()),
    ("state", pa.list_(pa.float32(), len(STATE_NAMES))),
    ("num_components", pa.int32()),
    ("genus", INTS),
    ("ambiguous", pa.bool_()),
    ("positions", VECTORS),
    ("labels", pa.list_(pa.uint8())),
]
OF_SCENE = ("scene_index", "scene_id", "family", "split", "region")
OF_FRAME = ("frame_index", "timestamp", "num_components", "genus", "ambiguous")
CAMERA = [
    ("depth_unit", pa.float32()),
    ("camera_position", pa.list_(pa.float64(), 3)),
    ("camera_quaternion", pa.list_(pa.float64(), 4)),
    ("intrinsics", pa.list_(pa.float64(), 4)),
]


class HuggingFace:
    """A `datasets` folder: `data/<split>-00000-of-00001.parquet` and a card with its splits."""

    def export(
        self,
        dataset: Dataset,
        scenes: Sequence[int],
        out: Path,
        *,
        sensors: str | None = None,
        particles: bool = True,
    ) -> tuple[Path, ...]:
        """Write scenes.

        Args:
            dataset: what was not made, or not recorded, is null.
            scenes: scene indices.
            out: a new or empty folder.
            sensors: comma-separated; by default every sensor that the dataset has.
            particles: positions and labels of the particles, which take most of the space.

        Raises:
            BadInputError: no scene, or the folder is not empty.
            MissingLayerError: a sensor that nobody rendered with.
        """
        if not len(scenes):
            raise BadInputError("there is no scene to export")
        images = image_names(dataset, scenes, chosen_sensors(dataset, sensors))
        schema = _schema(images, particles=particles)
        of_split: dict[str, list[int]] = {}
        splits = scene_splits(dataset)
        for index in scenes:
            of_split.setdefault(splits[index], []).append(index)
        with new_folder(out) as folder:
            (folder / "data").mkdir()
            for split, indices in of_split.items():
                rows = (_rows(dataset, index, images, particles=particles) for index in indices)
                _write(folder / "data", split, rows, schema)
            (folder / "README.md").write_text(_card(of_split))
            written = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
        return tuple(out / path for path in written)


def _schema(images: dict[str, list[str]], *, particles: bool) -> pa.Schema:
    """Arrow's types, and what `datasets` makes of them in the metadata."""
    columns = [c for c in COLUMNS if particles or c[0] not in ("positions", "labels")]
    for name in (name for names in images.values() for name in names):
        columns += [(f"depth_{name}", IMAGE), (f"segments_{name}", IMAGE)]
        columns += [(f"{column}_{name}", kind) for column, kind in CAMERA]
    features = {name: _feature(kind) for name, kind in columns}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema(columns, metadata=metadata)


def _feature(kind: pa.DataType) -> dict[str, Any]:
    """An Arrow type in the words of `datasets`."""
    if kind == IMAGE:
        return {"_type": "Image"}
    if pa.types.is_fixed_size_list(kind):
        feature = _feature(kind.value_type)
        return {"feature": feature, "length": kind.list_size, "_type": "Sequence"}
    if pa.types.is_list(kind):
        return {"feature": _feature(kind.value_type), "_type": "Sequence"}
    dtype = {"double": "float64", "float": "float32"}.get(str(kind), str(kind))
    return {"dtype": dtype, "_type": "Value"}


def _rows(
    dataset: Dataset, scene: int, images: dict[str, list[str]], *, particles: bool
) -> list[dict[str, Any]]:
    """All key frames of a scene."""
    (described,) = rows_of(dataset, "scenes", scene)
    seen, states = scene_images(dataset, scene, images), scene_states(dataset, scene)
    rows = []
    for frame in rows_of(dataset, "frames", scene):
        key = frame["frame_index"]
        row = {name: described[name] for name in OF_SCENE} | {
            name: frame[name] for name in OF_FRAME
        }
        row["state"] = states.get(key)
        if particles:
            row |= _particles(dataset.frame(scene=scene, frame=key))
        for name, image in seen.get(key, {}).items():
            row |= _image_columns(name, image)
        rows.append(row)
    return rows


def _particles(frame: Frame) -> dict[str, Any]:
    """Positions and labels; what was not made is left out."""
    found: dict[str, Any] = {}
    with suppress(MissingLayerError):
        found["positions"] = list(frame.particles.positions)
        found["labels"] = frame.topology.labels
    return found


def _image_columns(name: str, image: Image) -> dict[str, Any]:
    k = image.camera.intrinsics
    return {
        f"depth_{name}": {"bytes": png(image.depth), "path": None},
        f"segments_{name}": {"bytes": png(image.segments), "path": None},
        f"depth_unit_{name}": image.depth_unit,
        f"camera_position_{name}": image.camera.position,
        f"camera_quaternion_{name}": image.camera.quaternion,
        f"intrinsics_{name}": (k.fx, k.fy, k.cx, k.cy),
    }


def _write(
    folder: Path, split: str, scenes: Iterator[list[dict[str, Any]]], schema: pa.Schema
) -> None:
    """Parquet files of one split; each takes whole scenes. Their number is known at the end."""
    parts: list[Path] = []
    writer, size = None, 0
    try:
        for rows in scenes:
            if writer is None:
                parts.append(folder / f"{split}-{len(parts):05d}.parquet")
                writer, size = pq.ParquetWriter(parts[-1], schema, compression="zstd"), 0
            table = pa.Table.from_pylist(rows, schema=schema)
            writer.write_table(table)
            size += table.nbytes
            if size >= FILE_BYTES:
                writer.close()
                writer = None
    finally:
        if writer is not None:
            writer.close()
    for part in parts:
        part.rename(folder / f"{part.stem}-of-{len(parts):05d}.parquet")


def _card(splits: dict[str, list[int]]) -> str:
    lines = ["---", "task_categories:", "- robotics", "configs:", "- config_name: default"]
    lines += ["  data_files:"]
    for split in splits:
        lines += [f"  - split: {split}", f"    path: data/{split}-*"]
    state = ", ".join(STATE_NAMES)
    return "\n".join([*lines, "---", "", CARD.format(state=state)])


CARD = """# Dough with ground-truth topology

One row a key frame, in SI units. `state`: {state}. `genus` has one entry a component,
`labels` one a particle (255 = a crumb). `depth_*` are 16-bit PNGs in units of `depth_unit_*`
metres, 0 = invalid; `segments_*`: 0 nothing, 1 table, 2 tool, 16 + k component k.
`intrinsics_*`: fx, fy, cx, cy.
"""
