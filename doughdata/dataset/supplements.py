"""Columns that a later version of the format adds to tables which were committed before it.

What lies below `data/` never changes, so they stand beside it: one JSON document for a commit,
published once, checked against the commit that it belongs to. Older readers do not look there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from doughdata.dataset.commits import CommitRecord
from doughdata.dataset.contacts import CONTACT_COLUMNS, contact_arrays
from doughdata.dataset.documents import dump_document, load_document
from doughdata.dataset.store import Store
from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = [
    "SUPPLEMENTS",
    "Supplement",
    "has_contacts",
    "read_schema",
    "read_supplement",
    "supplement_arrays",
    "with_contacts",
]

SUPPLEMENTS = "meta/supplements/1.1"  # by the version that added the columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Supplement:
    """Columns of the table `frames` of one commit (`v1/supplement.json`)."""

    layer: str
    shard: str
    revision: int
    commit: str  # sha256 of the commit record's file
    columns: Mapping[str, Sequence[Any]]  # name -> one value a row of the table

    @property
    def name(self) -> str:
        """Path of the document in the dataset."""
        return name_of(self.layer, self.shard, self.revision)

    def dump(self) -> bytes:
        """Bytes of the document."""
        fields = {name: getattr(self, name) for name in ("layer", "shard", "revision", "commit")}
        columns = {name: list(values) for name, values in self.columns.items()}
        return dump_document({"schema_version": SCHEMA_VERSION, **fields, "columns": columns})


def name_of(layer: str, shard: str, revision: int) -> str:
    """Path of the supplement of a commit."""
    return f"{SUPPLEMENTS}/{layer}/{shard}.{revision}.json"


def has_contacts(layer: str, table: pa.Table | pa.Schema) -> bool:
    """Whether a layer's table `frames` has the columns of format 1.1 itself."""
    names = table.names if isinstance(table, pa.Schema) else table.column_names
    return all(name in names for name, _ in CONTACT_COLUMNS[layer])


def read_schema(store: Store, commit: CommitRecord) -> pa.Schema:
    """Columns of a commit's table `frames`. Raises DamagedDatasetError."""
    path = f"{commit.path}/frames.parquet"
    try:
        return pq.read_schema(BytesIO(store.read(path)))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DamagedDatasetError(f"{store.uri}: {path} cannot be read: {error}") from error


def read_supplement(store: Store, commit: CommitRecord) -> Supplement | None:
    """What was added to a commit; None if nothing was.

    Raises:
        DamagedDatasetError: it has changed, or belongs to another commit.
    """
    name = name_of(commit.layer, commit.shard, commit.revision)
    if not store.exists(name):
        return None
    document = load_document(store.read(name), name=f"{store.uri}: {name}")
    try:
        columns = {column: document["columns"][column] for column, _ in _columns(commit.layer)}
        found = Supplement(
            layer=document["layer"],
            shard=document["shard"],
            revision=document["revision"],
            commit=document["commit"],
            columns=columns,
        )
    except (KeyError, TypeError) as error:
        raise DamagedDatasetError(f"{store.uri}: {name}: not a supplement ({error})") from error
    if found.commit != commit.hash or found.name != name:
        raise DamagedDatasetError(f"{store.uri}: {name} does not belong to {commit.name}")
    return found


def with_contacts(store: Store, commit: CommitRecord, table: pa.Table) -> pa.Table:
    """The table `frames` of a commit with its columns of format 1.1, null if nobody computed them.

    Raises:
        DamagedDatasetError: the supplement is damaged.
    """
    columns = _columns(commit.layer)
    if not columns or has_contacts(commit.layer, table):
        return table
    supplement = read_supplement(store, commit)
    if supplement is None:
        added = {name: pa.nulls(len(table), kind) for name, kind in columns}
    else:
        added = supplement_arrays(store, commit, supplement, rows=len(table))
    for name, values in added.items():
        table = table.append_column(name, values)
    return table


def _columns(layer: str) -> list[tuple[str, pa.DataType]]:
    return CONTACT_COLUMNS.get(layer, [])


def supplement_arrays(
    store: Store, commit: CommitRecord, supplement: Supplement, *, rows: int
) -> dict[str, pa.Array]:
    """The columns of a supplement with their types.

    Raises:
        DamagedDatasetError: another number or kind of values than the table has.
    """
    try:
        arrays = contact_arrays(commit.layer, supplement.columns)
    except (TypeError, pa.ArrowException) as error:
        raise DamagedDatasetError(f"{store.uri}: {supplement.name}: {error}") from error
    if any(len(values) != rows for values in arrays.values()):
        raise DamagedDatasetError(
            f"{store.uri}: {supplement.name} must have {rows} values a column, as the table has"
        )
    return arrays
