"""Reading: whole scenes for the stages, single frames for people and training.

ds = open_dataset("dough-dataset")
frame = ds.frame(scene=0, frame=60)
frame.topology.num_components, frame.meshes[0].vertices, frame.depth("realsense").depth
"""

import json
import os
from bisect import bisect_right
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from doughdata.dataset.assets import resolve_path
from doughdata.dataset.commits import RECORDED, CommitLog, CommitRecord
from doughdata.dataset.contacts import CONTACT_COLUMNS, FrameContacts
from doughdata.dataset.frame import Frame
from doughdata.dataset.info import read_info
from doughdata.dataset.layers import (
    decode_depth,
    decode_label_grid,
    decode_meshes,
    decode_particles,
    decode_topology,
)
from doughdata.dataset.plan import PlanRecord, read_plans
from doughdata.dataset.shards import LayerShard, ShardRows, read_table
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.tables import TABLES, build_tables
from doughdata.scenes import scene_from_json
from doughschemas import (
    BadInputError,
    ComponentMeshes,
    DepthViews,
    MissingLayerError,
    Particles,
    Scene,
    Topology,
)

__all__ = ["Dataset", "open_dataset"]

OPEN_BYTES = 2**28  # of tables and indices of committed layers that a process keeps in memory
OPEN_LEAST = 32  # layers that are kept whatever their size; their sizes are added up as often


@dataclass(slots=True)
class _Opened:
    """What one process has read so far; never shared with another process."""

    info: dict[str, Any]
    plans: list[PlanRecord]
    log: CommitLog
    tables: dict[str, pa.Table] = field(default_factory=dict)
    scenes: dict[int, Scene] = field(default_factory=dict)
    fresh: dict[str, dict[str, CommitRecord]] = field(default_factory=dict)
    places: dict[int, str] = field(default_factory=dict)  # scene_index -> shard
    shards: OrderedDict[tuple[str, str], LayerShard] = field(default_factory=OrderedDict)


class Dataset:
    """A dataset as it was when this object was made. Picklable; safe after fork and spawn.

    Every process opens the files for itself when it first reads.
    """

    def __init__(self, uri: str | Path | Store) -> None:
        self._store = store_of(uri)
        self._opened: dict[int, _Opened] = {}
        _ = self._here  # so that a wrong path is reported here, not at the first read

    def __getstate__(self) -> dict[str, Any]:
        return {"_store": self._store, "_opened": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    def __enter__(self) -> "Dataset":
        return self

    def __exit__(self, *error: Any) -> None:
        self._opened = {}

    def __len__(self) -> int:
        """Number of scenes with a `sim` layer; `scene_indices` are theirs."""
        return len(self.scenes)

    def __repr__(self) -> str:
        return f"Dataset({self.uri!r}, scenes={len(self)}, layers={self.layers})"

    @property
    def uri(self) -> str:
        """Where the dataset lies."""
        return self._store.uri

    @property
    def info(self) -> dict[str, Any]:
        """`meta/info.json`."""
        return self._here.info

    @property
    def num_frames(self) -> int:
        """Key frames a scene."""
        return self.info["num_frames"]

    @property
    def layers(self) -> list[str]:
        """Layers that at least one shard has, in the order of the stages."""
        return self._here.log.layers

    @property
    def fingerprint(self) -> str:
        """sha256 of the content as of the last refresh; equal data have equal fingerprints."""
        return self.info["fingerprint"]

    @property
    def scene_indices(self) -> list[int]:
        """scene_index of every scene with a `sim` layer; a scene that failed leaves a gap."""
        return self.scenes["scene_index"].to_pylist()

    @property
    def scenes(self) -> pa.Table:
        """`meta/scenes.parquet`."""
        return self.table("scenes")

    @property
    def frames(self) -> pa.Table:
        """`meta/frames.parquet`."""
        return self.table("frames")

    def table(self, name: str) -> pa.Table:
        """A derived table; built in memory if the dataset was never refreshed.

        Raises:
            BadInputError: there is no table of that name; the message lists them.
            DamagedDatasetError: the file is damaged.
        """
        if name not in TABLES:
            raise BadInputError(f"no table {name!r} (there are: {', '.join(TABLES)})")
        here, path = self._here, f"meta/{name}.parquet"
        if name not in here.tables and self._store.exists(path):
            here.tables[name] = read_table(self._store, path)
        if name not in here.tables:
            here.tables = build_tables(self._store, here.log, here.info)
        return here.tables[name]

    def scene(self, scene_index: int) -> Scene:
        """What a scene was made from; meshes have paths on this machine."""
        scenes = self._here.scenes
        if scene_index not in scenes:
            table = self.layer("sim", scene_index).table("scenes")
            data = json.loads(table.value("parameters", table.scene_rows(scene_index).start))
            locate = partial(resolve_path, self._store)
            scenes[scene_index] = scene_from_json(
                data, name=data["scene_id"], locate=locate, stored=True
            )
        return scenes[scene_index]

    def frame(self, *, scene: int, frame: int) -> Frame:
        """One key frame; its parts are read when they are asked for.

        Raises:
            BadInputError: no such key frame.
            MissingLayerError: the scene has not been simulated.
        """
        if not 0 <= frame < self.num_frames:
            raise BadInputError(f"key frame must be 0..{self.num_frames - 1}, got {frame}")
        base = self.base_layer(scene)
        if base == RECORDED and frame >= len(self.layer(base, scene).table("frames").scene(scene)):
            raise BadInputError(f"{self.uri}: recording {scene} has no key frame {frame}")
        return Frame(self, scene, frame)

    def base_layer(self, scene_index: int) -> str:
        """The layer that a scene begins with: `sim`, or `depth.recorded` of a recording.

        Raises:
            BadInputError: the dataset has no such scene.
            MissingLayerError: the scene has not been simulated.
        """
        shard = self._shard_of(scene_index)
        if self._here.log.newest(RECORDED, shard) is not None:
            return RECORDED
        self.layer("sim", scene_index)
        return "sim"

    def read_particles(self, scene_index: int) -> Particles:
        """All key frames of a scene's `sim` layer."""
        return decode_particles(self.layer("sim", scene_index), scene_index)

    def read_topology(self, scene_index: int) -> Topology:
        """All key frames of a scene's `topology` layer, with events and bonds."""
        sim = self.layer("sim", scene_index)
        count = int(sim.array("num_particles").row(sim.rows.start(scene_index)))
        shard = self.layer("topology", scene_index)
        return decode_topology(shard, scene_index, num_particles=count)

    def read_contacts(self, scene_index: int, frame_index: int) -> FrameContacts:
        """What touches what in one key frame.

        Raises:
            MissingLayerError: there is no `sim` layer, or it is of format 1.0 and nobody computed
                the contacts; the message names the command that does it.
        """
        found: dict[str, Any] = {}
        for layer, columns in CONTACT_COLUMNS.items():
            try:
                shard = self.layer(layer, scene_index)
            except MissingLayerError:
                if layer == "sim":
                    raise
                continue
            frames = shard.frames_with_contacts()
            row = frames.frame_rows(scene_index, frame_index).start
            found |= {name: _known(frames.value(name, row)) for name, _ in columns}
        # Fingers alone may be unknown: of a key frame whose action the scene does not have.
        counts = [
            found[name] for name in ("table_contacts", "touching_components") if name in found
        ]
        if None in counts:
            raise MissingLayerError(
                f"{self.uri}: scene {scene_index} has no contacts, it was written in format 1.0; "
                f"`doughdata migrate --dataset {self.uri}` computes them"
            )
        fingers, pairs = found["finger_contacts"], found.get("touching_components")
        itself = found.get("self_contact")
        return FrameContacts(
            fingers=None if fingers is None else tuple(fingers),
            table=int(found["table_contacts"]),
            components=None if pairs is None else int(pairs),
            itself=None if itself is None else bool(itself),
        )

    def read_meshes(self, scene_index: int, frame_index: int) -> ComponentMeshes:
        """Meshes and label grid of one key frame."""
        shard = self.layer("mesh", scene_index)
        return ComponentMeshes(
            meshes=decode_meshes(shard, scene_index, frame_index),
            label_grid=decode_label_grid(shard, scene_index, frame_index),
        )

    def read_depth(self, scene_index: int, sensor: str) -> DepthViews:
        """All views of a scene from one sensor."""
        return decode_depth(self.layer(f"depth.{sensor}", scene_index), scene_index)

    def layer(self, layer: str, scene_index: int) -> LayerShard:
        """The committed layer that holds a scene.

        Raises:
            BadInputError: the dataset has no such scene.
            MissingLayerError: the layer was not made, is stale, or this scene failed in it; the
                message names the command that makes it.
        """
        shard = self._shard_of(scene_index)
        here = self._here
        if layer != RECORDED and here.log.newest(RECORDED, shard) is not None:
            raise MissingLayerError(
                f"{self.uri}: scene {scene_index} was recorded by a real camera: it has the layer "
                f"{RECORDED!r} alone, not {layer!r}"
            )
        if shard not in here.fresh:
            here.fresh[shard] = here.log.fresh(shard)
        commits = here.fresh[shard]
        if layer not in commits:
            raise MissingLayerError(
                f"{self.uri}: scene {scene_index} has no layer {layer!r}; "
                f"make it with `{command_for(layer)} --dataset {self.uri}`"
            )
        if scene_index not in commits[layer].scenes:
            reason = commits[layer].failed.get(scene_index, "an earlier layer failed")
            raise MissingLayerError(
                f"{self.uri}: scene {scene_index} failed in layer {layer!r} ({reason}); try again "
                f"with `{command_for(layer)} --retry-failed --dataset {self.uri}`"
            )
        return self._open(commits[layer], commits.get("sim") or commits[layer])

    @property
    def _here(self) -> _Opened:
        """The state of this very process."""
        pid = os.getpid()
        if pid not in self._opened:
            info = read_info(self._store)
            opened = _Opened(info, read_plans(self._store), CommitLog(self._store))
            self._opened = {pid: opened}
        return self._opened[pid]

    def _shard_of(self, scene_index: int) -> str:
        here = self._here
        if scene_index in here.places:
            return here.places[scene_index]
        plans = here.plans
        total = sum(plan.count for plan in plans)
        if not 0 <= scene_index < total:
            raise BadInputError(f"{self.uri}: no scene {scene_index} (it has 0..{total - 1})")
        plan = plans[bisect_right(plans, scene_index, key=lambda p: p.first_scene_index) - 1]
        place = (scene_index - plan.first_scene_index) // plan.scenes_per_shard
        here.places[scene_index] = f"{plan.first_shard + place:05d}"
        return here.places[scene_index]

    def _open(self, commit: CommitRecord, sim: CommitRecord) -> LayerShard:
        shards, key = self._here.shards, (commit.layer, commit.shard)
        if key not in shards:
            rows = ShardRows(scenes=sim.scenes, num_frames=self.num_frames)
            shards[key] = LayerShard(self._store, commit, rows)
            if len(shards) % OPEN_LEAST == 0:
                _forget_oldest(shards)
        shards.move_to_end(key)
        return shards[key]


def _known(value: Any) -> Any:
    """A value of a column; nulls among numbers come as NaN."""
    return None if value is None or value != value else value


def _forget_oldest(shards: OrderedDict[tuple[str, str], LayerShard]) -> None:
    """Drop what was not used for longest, until the rest is small enough."""
    total = sum(shard.nbytes for shard in shards.values())
    while total > OPEN_BYTES and len(shards) > OPEN_LEAST:
        _, oldest = shards.popitem(last=False)
        total -= oldest.nbytes


def command_for(layer: str) -> str:
    """The command that makes a layer."""
    stages = {"sim": "simulate", "topology": "topology", "mesh": "mesh"}
    if layer == RECORDED:
        return "doughdata convert RECORDING"
    if layer in stages:
        return f"doughdata generate --stages {stages[layer]}"
    return f"doughdata render --noise {layer.partition('.')[2]}"


def open_dataset(uri: str | Path | Store) -> Dataset:
    """Open a dataset for reading.

    Raises:
        DatasetError: no dataset there, or a URI that this release cannot reach.
        VersionError: a schema that this release cannot read.
        DamagedDatasetError: `meta/info.json` or a plan record has changed.
    """
    return Dataset(uri)
