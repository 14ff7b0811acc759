"""`meta/info.json`: what a dataset is, fixed when it is made, and its totals."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from doughdata.dataset.commits import RECORDED, StageRecord
from doughdata.dataset.documents import dump_document, load_document, plain_json
from doughdata.dataset.store import Store
from doughschemas import SCHEMA_VERSION, DatasetError, VersionError
from doughschemas.migrate import check_version, is_newer

__all__ = [
    "DatasetSettings",
    "create_info",
    "default_scenes_per_shard",
    "read_info",
    "refuse_newer",
]

INFO = "meta/info.json"
# LeRobot's style; null = differs from row to row. A depth layer's features have its sensor's name.
FEATURES = {
    "sim": {
        "positions": ("float32", [None, 3], ["particle", "xyz"]),
        "object_ids": ("uint8", [None], ["particle"]),
        "num_particles": ("int32", [], []),
    },
    "topology": {"labels": ("uint8", [None], ["particle"])},
    "mesh": {
        "vertices": ("float32", [None, 3], ["vertex", "xyz"]),
        "faces": ("uint32", [None, 3], ["face", "corner"]),
        "vertex_offsets": ("uint32", [None], ["component"]),
        "face_offsets": ("uint32", [None], ["component"]),
        "num_meshes": ("uint8", [], []),
        "label_grid": ("uint8", [None, None, None], ["x", "y", "z"]),
        "label_grid_origin": ("float64", [3], ["xyz"]),
        "label_grid_shape": ("uint32", [3], ["xyz"]),
    },
    "depth": {
        "depth": ("uint16", [None, None], ["y", "x"]),
        "segments": ("uint8", [None, None], ["y", "x"]),
    },
}
RECORDED_FEATURES = {"color": ("uint8", [None, None, 3], ["y", "x", "rgb"])}


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetSettings:
    """What is fixed when a dataset is made; None and absent stages fit any dataset."""

    num_frames: int | None = None  # key frames a scene; 75 when a dataset is made
    scenes_per_shard: int | None = None  # 1 when a dataset is made
    stages: Mapping[str, StageRecord] = field(default_factory=dict)  # layer -> what makes it


def default_scenes_per_shard(num_scenes: int) -> int:
    """Shard size that keeps the number of files low: 1 below 64 scenes, 8 below 1,000, else 32."""
    if num_scenes < 64:
        return 1
    return 8 if num_scenes < 1000 else 32


def create_info(store: Store, settings: DatasetSettings) -> dict[str, Any]:
    """Make a dataset, unless one is there; returns its info, checked against the settings.

    Raises:
        DatasetError: the folder holds something else, or a setting differs; the message names it.
        VersionError: a newer release made the dataset.
    """
    if not store.exists(INFO):
        refuse_strangers(store)
        store.create(INFO, dump_document(_new_info(settings)))
    info = read_info(store)
    refuse_newer(store.uri, info)
    check_settings(store.uri, info, settings)
    return info


def read_info(store: Store) -> dict[str, Any]:
    """Info of an existing dataset, its version checked.

    Raises:
        DatasetError: no dataset here.
        VersionError: a schema that this release cannot read.
    """
    if not store.exists(INFO):
        if store.exists(""):
            raise DatasetError(f"{store.uri} is not a dataset: it has no {INFO}")
        raise DatasetError(
            f"{store.uri}: no such dataset; `doughdata generate --scenes rolls` makes one"
        )
    info = load_document(store.read(INFO), name=f"{store.uri}: {INFO}")
    check_version(str(info.get("schema_version")), what=store.uri)
    return info


def refuse_newer(uri: str, info: Mapping[str, Any]) -> None:
    """Raise VersionError if a newer release wrote a dataset: what it added would be lost."""
    version = str(info["schema_version"])
    if is_newer(version, what=uri):
        raise VersionError(
            f"{uri} has schema version {version}; this release writes up to {SCHEMA_VERSION}: "
            "upgrade doughdata, nothing was touched"
        )


def write_info(store: Store, info: Mapping[str, Any]) -> None:
    """Replace the info; its checksum is renewed."""
    store.replace(INFO, dump_document(info))


def features_of(layers: Mapping[str, Any]) -> dict[str, Any]:
    """Features of the layers that exist: `<layer>/<array>` -> dtype, shape, names."""
    return {
        f"{layer}/{name}": {"dtype": dtype, "shape": shape, "names": names}
        for layer in layers
        for name, (dtype, shape, names) in features_of_layer(layer).items()
    }


def features_of_layer(layer: str) -> Mapping[str, tuple[str, list, list]]:
    """Array -> dtype, shape, names of a layer; a recording may have no colour all the same."""
    features = FEATURES[layer.partition(".")[0]]
    return {**features, **RECORDED_FEATURES} if layer == RECORDED else features


def check_settings(uri: str, info: Mapping[str, Any], settings: DatasetSettings) -> None:
    """Raise DatasetError naming the first setting that differs from the dataset's."""
    for name in ("num_frames", "scenes_per_shard"):
        wanted = getattr(settings, name)
        if wanted is not None and wanted != info[name]:
            refuse(uri, name, info[name], wanted)
    for layer, stage in settings.stages.items():
        if layer in info["stages"]:
            check_stage(uri, layer, info["stages"][layer], stage)


def check_stage(uri: str, layer: str, made: Mapping[str, Any], stage: StageRecord) -> None:
    """Raise DatasetError naming the first option that differs; the version may differ."""
    wanted = stage.to_json()
    if made["name"] != wanted["name"]:
        refuse(uri, f"{layer} stage", made["name"], wanted["name"])
    old, new = made["config"], wanted["config"]
    for key in sorted(set(old) | set(new)):
        if old.get(key) != new.get(key):
            refuse(uri, f"{layer}.{key}", old.get(key), new.get(key))


def refuse(uri: str, name: str, old: Any, new: Any) -> None:
    """Raise DatasetError about a changed configuration."""
    raise DatasetError(
        f"{uri} was made with {name} = {old!r}, not {new!r}; "
        "use the same configuration or another --dataset"
    )


def refuse_strangers(store: Store) -> None:
    """Raise DatasetError if the folder holds something that is not the start of a dataset."""
    if store.is_file(""):
        raise DatasetError(f"{store.uri} is a file; a dataset is a folder")
    strangers = [name for name in store.names("") if name != "meta"]
    strangers += [f"meta/{name}" for name in store.names("meta")]
    if strangers:
        raise DatasetError(
            f"{store.uri} holds something else ({strangers[0]}) and no dataset; "
            "choose an empty or new folder, nothing was touched"
        )


def _new_info(settings: DatasetSettings) -> dict[str, Any]:
    stages = {layer: stage.to_json() for layer, stage in settings.stages.items()}
    return plain_json(
        {
            "schema_version": SCHEMA_VERSION,
            "num_frames": 75 if settings.num_frames is None else settings.num_frames,
            "scenes_per_shard": settings.scenes_per_shard or 1,
            "fps": None,  # key frames are uniform over a scene's own duration
            "depth_unit": 1e-4,
            "stages": stages,
            "layers": [],
            "features": {},
            "splits": {},
            "total_scenes": 0,
            "total_frames": 0,
            "total_failed": 0,
            "tables": {},
            "fingerprint": "",
        }
    )
