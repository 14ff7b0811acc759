"""Writing: plan scenes, list what is to do, write layers, commit, refresh the tables.

A layer of a shard is written into an attempt folder of its own and exists from the moment when its
commit record is published. A crash leaves an attempt without a commit, which nobody reads.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any
from uuid import uuid4

from doughdata.dataset.arrays import encode_arrays, spooled_files
from doughdata.dataset.assets import located, store_meshes
from doughdata.dataset.commits import (
    RECORDED,
    CommitLog,
    CommitRecord,
    StageRecord,
    read_commit,
)
from doughdata.dataset.contacts import particle_contacts
from doughdata.dataset.info import (
    DatasetSettings,
    check_settings,
    check_stage,
    create_info,
    read_info,
    refuse_newer,
)
from doughdata.dataset.layers import (
    encode_depth,
    encode_mesh,
    encode_recorded,
    encode_sim,
    encode_topology,
)
from doughdata.dataset.plan import (
    PlanRecord,
    Shard,
    plan_family,
    plan_scenes,
    read_plans,
    scenes_of,
    shards_of,
)
from doughdata.dataset.reuse import earlier_records
from doughdata.dataset.shards import ARRAYS, Encoded, ShardRows, encode_table
from doughdata.dataset.store import LocalStore, Store, store_of
from doughdata.dataset.tables import refresh_tables
from doughdata.dataset.tasks import Earlier, Task, task_for
from doughschemas import BadInputError, DatasetError, Particles, Scene

__all__ = ["DatasetWriter", "open_writer"]


class DatasetWriter:
    """A dataset that is being made. Picklable; any number of processes may write at once."""

    def __init__(self, store: Store, info: Mapping[str, Any]) -> None:
        self.store, self.info = store, info

    @property
    def uri(self) -> str:
        """Where the dataset lies."""
        return self.store.uri

    @property
    def num_frames(self) -> int:
        """Key frames a scene."""
        return self.info["num_frames"]

    def plan_family(self, family: str, *, split: str, seed: int, count: int) -> list[Shard]:
        """Plan scenes 0..count-1 of a family: nothing if they are planned, the missing ones else.

        Returns all planned shards of (family, split, seed).

        Raises:
            UnknownNameError: nobody registered that family (when the scenes are asked for).
        """
        size = self.info["scenes_per_shard"]
        return plan_family(
            self.store, family, split=split, seed=seed, count=count, scenes_per_shard=size
        )

    def plan_scenes(self, scenes: Sequence[Scene]) -> list[Shard]:
        """Plan user-written scenes; those that are planned already (same content) are kept.

        Raises:
            DatasetError: another scene with the same scene_id is there.
        """
        return plan_scenes(self.store, scenes, scenes_per_shard=self.info["scenes_per_shard"])

    def shards(self) -> list[Shard]:
        """All planned shards, in order."""
        return [shard for plan in read_plans(self.store) for shard in shards_of(plan)]

    def scenes(self, task: Task) -> dict[int, Scene]:
        """The scenes of a task, scene_index -> Scene; tool meshes have paths on this machine."""
        return scenes_of(self.store, self._plan(task.shard), task.scenes)

    def tasks(
        self,
        layer: str,
        *,
        shards: Sequence[Shard] | None = None,
        retry_failed: bool = False,
        replace_with: StageRecord | None = None,
    ) -> list[Task]:
        """What is to do for a layer: missing shards and stale ones (made from an older revision).

        Shards whose upstream layers are not there yet are left out. `retry_failed` adds the shards
        in which a scene failed; `replace_with` those that a stage of another name or configuration
        made (for example with other camera views), so that an interrupted replacement resumes too.
        """
        log = CommitLog(self.store)
        tasks = (
            task_for(layer, shard, log, retry_failed=retry_failed, replace_with=replace_with)
            for shard in (self.shards() if shards is None else shards)
        )
        return [task for task in tasks if task is not None]

    def check_stage(self, layer: str, stage: StageRecord) -> None:
        """Refuse a stage whose name or configuration differs from what made this layer so far.

        Raises:
            DatasetError: the message names the option, both values and what to do.
        """
        check_settings(self.uri, self.info, DatasetSettings(stages={layer: stage}))
        if layer in self.info["stages"]:
            return
        log = CommitLog(self.store)
        commits = (log.newest(layer, shard) for shard in log.shards)
        made = next((commit for commit in commits if commit is not None), None)
        if made is not None:
            check_stage(self.uri, layer, made.stage.to_json(), stage)

    def write(
        self,
        task: Task,
        records: Mapping[int, Any],
        *,
        stage: StageRecord,
        failed: Mapping[int, str] | None = None,
        scenes: Mapping[int, Scene] | None = None,
    ) -> CommitRecord:
        """Write and commit one layer of one shard; returns the commit that counts.

        Args:
            task: from `tasks`.
            records: scene_index -> `Particles` (sim), `Topology` (topology), a sequence of
                `ComponentMeshes`, one a key frame (mesh), `DepthViews` (depth.<sensor>) or
                `RecordedScene` (depth.recorded).
            stage: what made them.
            failed: scene_index -> reason (one line) of the scenes without a record.
            scenes: scene_index -> `Scene`, for layer `sim`; None = those of the plan.

        If another process committed the same revision first, its commit is returned and the
        attempt is removed.

        Raises:
            BadInputError: records that do not fit the task or each other.
            DatasetError: the disk is full or read-only; nothing that was finished is lost.
        """
        failed = dict(failed or {})
        if sorted([*records, *failed]) != sorted(task.scenes):
            raise BadInputError(
                f"{task.layer} {task.shard}: records and failures must cover scenes "
                f"{list(task.scenes)} exactly, got {sorted(records)} and {sorted(failed)}"
            )
        commit = CommitRecord(
            layer=task.layer,
            shard=task.shard,
            revision=task.revision,
            path=None,
            files={},
            scenes=tuple(sorted(records)),
            failed={index: failed[index] for index in sorted(failed)},
            stage=stage,
            upstream=dict(task.upstream),
        )
        if not records:
            return self._publish(commit)
        encoded = self._encode(task, records, scenes)
        path = f"data/{task.layer}/{task.shard}-{uuid4().hex[:12]}"
        files = encode_files(encoded, commit)
        self.store.write_folder(path, files)
        hashes = {name: _digest(data) for name, data in files.items()}
        try:
            return self._publish(replace(commit, path=path, files=hashes))
        except BaseException:
            # Here, what failed did not happen. A request to an object store may still arrive, and
            # then its record names this attempt: it stays, and `gc` removes it if it is an orphan.
            if isinstance(self.store, LocalStore) and not self.store.exists(commit.name):
                self.store.remove(path)
            raise

    def earlier(self, task: Task, stage: StageRecord) -> Earlier:
        """What the commit that a task replaces holds already (see `reuse`)."""
        if task.revision == 0:  # the usual case: nothing to list
            return Earlier(commit=None, fresh=False, records={})
        log = CommitLog(self.store)
        commit = log.newest(task.layer, task.shard)
        if commit is None:
            return Earlier(commit=None, fresh=False, records={})
        records = earlier_records(
            self.store, commit, stage, task.scenes, num_frames=self.num_frames
        )
        return Earlier(commit=commit, fresh=task.layer in log.fresh(task.shard), records=records)

    def refresh(self) -> None:
        """Rebuild the derived tables and the totals in info.json from the commits; atomic."""
        self.info = refresh_tables(self.store)

    def _encode(
        self, task: Task, records: Mapping[int, Any], scenes: Mapping[int, Scene] | None
    ) -> Encoded:
        kind = task.layer.partition(".")[0]
        if kind == "sim":
            rows = ShardRows(scenes=tuple(sorted(records)), num_frames=self.num_frames)
            scenes = self.scenes(task) if scenes is None else scenes
            stored = {index: store_meshes(self.store, scenes[index]) for index in records}
            here = {index: located(self.store, scene) for index, scene in stored.items()}
            return encode_sim(records, stored, rows, contacts=contacts_of(records, here))
        if task.layer == RECORDED:
            recorded = ShardRows(scenes=tuple(sorted(records)), num_frames=self.num_frames)
            return encode_recorded(records, recorded)
        sim = CommitLog(self.store).newest("sim", task.shard)
        if sim is None:
            raise DatasetError(f"{self.uri}: shard {task.shard} has no sim layer to refer to")
        rows = ShardRows(scenes=sim.scenes, num_frames=self.num_frames)
        encode = {"topology": encode_topology, "mesh": encode_mesh, "depth": encode_depth}[kind]
        return encode(records, rows)

    def _publish(self, commit: CommitRecord) -> CommitRecord:
        """Create the commit record; if another process was first, drop this attempt."""
        created = self.store.create(commit.name, commit.dump())
        winner = read_commit(self.store, commit.layer, commit.shard, commit.revision)
        # A store whose answer was lost and asked again says that the record existed: it is ours.
        if not created and commit.path is not None and winner.path != commit.path:
            self.store.remove(commit.path)
        return winner

    def _plan(self, shard: str) -> PlanRecord:
        for plan in read_plans(self.store):
            if plan.first_shard <= int(shard) < plan.first_shard + plan.num_shards:
                return plan
        raise DatasetError(f"{self.uri}: shard {shard} is not planned")


def open_writer(uri: str | Path | Store, settings: DatasetSettings | None = None) -> DatasetWriter:
    """Open a dataset for writing; with settings it is made if it is not there.

    Raises:
        DatasetError: the folder holds something else, a setting differs from the dataset's (the
            message names it), or there is no dataset and `settings` is None.
        VersionError: a schema that this release cannot write.
    """
    store = store_of(uri)
    info = read_info(store) if settings is None else create_info(store, settings)
    refuse_newer(store.uri, info)
    return DatasetWriter(store, info)


def encode_files(encoded: Encoded, commit: CommitRecord) -> dict[str, bytes | Path]:
    """Content of an attempt folder: name -> bytes, or a file that has them."""
    attributes = {"layer": commit.layer, "shard": commit.shard, "scenes": list(commit.scenes)}
    arrays: dict[str, bytes | Path] = {
        **encode_arrays(encoded.arrays, attributes=attributes),
        **spooled_files(encoded.arrays),
    }
    tables = {
        f"{name}.parquet": encode_table(table, parts=True) for name, table in encoded.tables.items()
    }
    return {**{f"{ARRAYS}/{name}": data for name, data in arrays.items()}, **tables}


def contacts_of(
    records: Mapping[int, Particles], scenes: Mapping[int, Scene]
) -> dict[int, dict[str, list[Any]]]:
    """What touches what in every key frame of some scenes, whose meshes lie on this machine."""
    return {index: particle_contacts(records[index], scenes[index]) for index in sorted(records)}


def _digest(data: bytes | Path) -> str:
    """Hex sha256 of what a file holds or will hold."""
    if isinstance(data, bytes):
        return sha256(data).hexdigest()
    with data.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()
