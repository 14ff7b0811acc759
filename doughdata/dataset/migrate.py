"""Bringing an older dataset forward, without touching a byte of what was committed.

1.0 -> 1.1: every commit of `sim` and `topology` gets a supplement with the contact columns of its
key frames; then the derived tables are rebuilt and `meta/info.json` says 1.1. Supplements are
published one by one and never replaced, and the version comes last: whenever it is interrupted, the
dataset reads as before (`validate` may call derived tables outdated), and the same call goes on.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset.commits import CommitLog, CommitRecord
from doughdata.dataset.completion import computed_columns
from doughdata.dataset.contacts import CONTACT_COLUMNS
from doughdata.dataset.info import read_info, refuse_newer
from doughdata.dataset.shards import LayerShard, ShardRows
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.supplements import (
    Supplement,
    has_contacts,
    read_schema,
    read_supplement,
)
from doughdata.dataset.tables import refresh_tables, table_schemas
from doughschemas import SCHEMA_VERSION, DamagedDatasetError, DatasetError
from doughschemas.migrate import migration_path

__all__ = ["Migrated", "migrate"]

OnScenes = Callable[[int, int], None]  # scenes done so far and in all, each layer counting


@dataclass(frozen=True, slots=True, kw_only=True)
class Migrated:
    """What `migrate` did, or would do."""

    dataset: str
    before: str  # schema version
    after: str
    supplements: int  # documents that were added
    kept: int  # that an earlier, interrupted call had added
    outdated: bool  # derived tables are not as this version has them, and are rebuilt

    @property
    def changed(self) -> bool:
        """Whether there was anything to do."""
        return self.before != self.after or self.supplements > 0 or self.outdated


def migrate(
    uri: str | Path | Store, *, dry_run: bool = False, on_scenes: OnScenes | None = None
) -> Migrated:
    """Bring a dataset to the newest schema version. The same call again goes on.

    A dataset that is newest already only gets what is missing: an older release that still writes
    to it adds commits without the newer columns.

    Raises:
        DatasetError: no dataset there, or the medium is full or read-only.
        VersionError: the dataset is newer than this release, or no step leads on from its version.
        DamagedDatasetError: a file that is needed has changed; the message names it.
        MissingPackageError: a mesh tool needs trimesh and Open3D.
    """
    store = store_of(uri)
    info = read_info(store)
    refuse_newer(store.uri, info)
    before = str(info["schema_version"])
    migration_path(before)
    log = CommitLog(store)
    lacking = list(_lacking(store, log))
    missing = [shard for shard, there in lacking if not there]
    result = Migrated(
        dataset=store.uri,
        before=before,
        after=SCHEMA_VERSION,
        supplements=len(missing),
        kept=len(lacking) - len(missing),
        outdated=_outdated(store),
    )
    if dry_run or not result.changed:
        return result
    done, total = 0, sum(len(commit.scenes) for commit in missing)
    for commit in missing:
        _publish(store, log, commit, num_frames=info["num_frames"])
        done += len(commit.scenes)
        if on_scenes is not None:
            on_scenes(done, total)
    refresh_tables(store, version=SCHEMA_VERSION)
    return result


def _outdated(store: Store) -> bool:
    """Whether a derived table is missing, damaged, or of another version's columns.

    An older release rebuilds them without the newer columns, and an interrupted call not at all.
    """
    for name, schema in table_schemas(SCHEMA_VERSION).items():
        try:
            found = pq.read_schema(pa.BufferReader(store.read(f"meta/{name}.parquet")))
        except (DatasetError, OSError, pa.ArrowException):
            return True
        version = (found.metadata or {}).get(b"schema_version")
        if version != SCHEMA_VERSION.encode() or not {*schema.names} <= {*found.names}:
            return True
    return False


def _lacking(store: Store, log: CommitLog) -> Iterator[tuple[CommitRecord, bool]]:
    """Commits that count whose tables have no contact columns, and whether a supplement has."""
    for shard in log.shards:
        fresh = log.fresh(shard)
        for layer in CONTACT_COLUMNS:
            commit = fresh.get(layer)
            if commit is None or commit.path is None:
                continue
            if not has_contacts(layer, read_schema(store, commit)):
                yield commit, read_supplement(store, commit) is not None


def _publish(store: Store, log: CommitLog, commit: CommitRecord, *, num_frames: int) -> None:
    """Add the supplement of one commit; another process may be first with the same values."""
    sim = log.fresh(commit.shard)["sim"]
    rows = ShardRows(scenes=sim.scenes, num_frames=num_frames)
    for needed in {commit.name: commit, sim.name: sim}.values():
        _verify(store, needed)
    shard = LayerShard(store, commit, rows)
    columns = computed_columns(store, shard, LayerShard(store, sim, rows))
    supplement = Supplement(
        layer=commit.layer,
        shard=commit.shard,
        revision=commit.revision,
        commit=commit.hash,
        columns=columns,
    )
    store.create(supplement.name, supplement.dump())


def _verify(store: Store, commit: CommitRecord) -> None:
    """Nothing is computed from bytes that have changed."""
    for name, digest in commit.files.items():
        path = f"{commit.path}/{name}"
        if sha256(store.read(path)).hexdigest() != digest:
            raise DamagedDatasetError(
                f"{store.uri}: {path} has changed since it was written (sha256); "
                f"`doughdata validate --deep --dataset {store.uri}` says what is hit"
            )
