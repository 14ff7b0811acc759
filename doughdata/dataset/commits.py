"""Commit records: what makes a layer of a shard exist."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from typing import Any

from doughdata.dataset.documents import dump_document, load_document, plain_json
from doughdata.dataset.store import Store
from doughschemas import SCHEMA_VERSION, DamagedDatasetError

__all__ = [
    "RECORDED",
    "UPSTREAM",
    "CommitLog",
    "CommitRecord",
    "StageRecord",
    "all_revisions",
    "list_layers",
    "read_commit",
    "upstream_of",
]

UPSTREAM = {  # layer -> layers that its stage reads
    "sim": (),
    "topology": ("sim",),
    "mesh": ("sim", "topology"),
    "depth": ("sim", "mesh"),
}

RECORDED = "depth.recorded"  # of a real camera: made from nothing that the dataset holds


def upstream_of(layer: str) -> tuple[str, ...]:
    """Layers that a layer is made from; `depth.<sensor>` counts as `depth`."""
    return () if layer == RECORDED else UPSTREAM[layer.partition(".")[0]]


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRecord:
    """What made a layer: the registered name, the version of its package, and its configuration."""

    name: str
    version: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        return plain_json({"name": self.name, "version": self.version, "config": dict(self.config)})

    def same(self, other: "StageRecord") -> bool:
        """Whether name and configuration are equal; the version may differ."""
        own, its = self.to_json(), other.to_json()
        return (own["name"], own["config"]) == (its["name"], its["config"])


@dataclass(frozen=True, slots=True, kw_only=True)
class CommitRecord:
    """One revision of one layer of one shard (`v1/commit.json`)."""

    layer: str
    shard: str
    revision: int
    path: str | None  # attempt folder, relative to the dataset; None = every scene failed
    files: Mapping[str, str]  # name relative to `path` -> sha256
    scenes: tuple[int, ...]  # scene_index of the scenes that are done, in row order
    failed: Mapping[int, str]  # scene_index -> reason
    stage: StageRecord
    upstream: Mapping[str, str]  # layer -> hash of the commit that this one was made from
    hash: str = ""  # sha256 of the record's file

    @property
    def name(self) -> str:
        """Path of the record in the dataset."""
        return f"meta/commits/{self.layer}/{self.shard}.{self.revision}.json"

    def dump(self) -> bytes:
        """Bytes of the record's file."""
        document = asdict(self)
        del document["hash"]
        document["stage"] = self.stage.to_json()
        document["failed"] = {str(index): reason for index, reason in self.failed.items()}
        return dump_document({"schema_version": SCHEMA_VERSION, **document})


def read_commit(store: Store, layer: str, shard: str, revision: int) -> CommitRecord:
    """One record, its checksum verified.

    Raises:
        DamagedDatasetError: missing, no JSON, changed, or without a field.
    """
    name = f"meta/commits/{layer}/{shard}.{revision}.json"
    data = store.read(name)
    document = load_document(data, name=f"{store.uri}: {name}")
    try:
        return CommitRecord(
            layer=document["layer"],
            shard=document["shard"],
            revision=document["revision"],
            path=document["path"],
            files=document["files"],
            scenes=tuple(document["scenes"]),
            failed={int(index): reason for index, reason in document["failed"].items()},
            stage=StageRecord(**{k: document["stage"][k] for k in ("name", "version", "config")}),
            upstream=document["upstream"],
            hash=sha256(data).hexdigest(),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamagedDatasetError(f"{store.uri}: {name}: not a commit record ({error})") from error


def all_revisions(store: Store, layer: str) -> dict[str, list[int]]:
    """Shard -> committed revisions of a layer, rising."""
    found: dict[str, list[int]] = {}
    for name in store.names(f"meta/commits/{layer}"):
        shard, revision, suffix = [*name.split("."), "", ""][:3]
        if suffix == "json" and revision.isdigit():
            found.setdefault(shard, []).append(int(revision))
    return {shard: sorted(revisions) for shard, revisions in found.items()}


def list_layers(store: Store) -> list[str]:
    """Layers that have at least one commit, in the order of the stages."""
    order = list(UPSTREAM)
    layers = [name for name in store.names("meta/commits") if name.partition(".")[0] in order]
    return sorted(layers, key=lambda layer: (order.index(layer.partition(".")[0]), layer))


class CommitLog:
    """The commits that count, as they were when the log was opened; records are read on demand."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._newest = {
            layer: {shard: found[-1] for shard, found in all_revisions(store, layer).items()}
            for layer in list_layers(store)
        }
        self._records: dict[tuple[str, str], CommitRecord] = {}

    @property
    def layers(self) -> list[str]:
        """Layers that have commits, in the order of the stages."""
        return list(self._newest)

    @property
    def shards(self) -> list[str]:
        """Shards that have a commit of any layer, sorted."""
        return sorted({shard for shards in self._newest.values() for shard in shards}, key=int)

    def newest(self, layer: str, shard: str) -> CommitRecord | None:
        """Highest revision of a layer of a shard, fresh or stale.

        Raises:
            DamagedDatasetError: the record is damaged.
        """
        revision = self._newest.get(layer, {}).get(shard)
        if revision is None:
            return None
        if (layer, shard) not in self._records:
            self._records[layer, shard] = read_commit(self._store, layer, shard, revision)
        return self._records[layer, shard]

    def fresh(self, shard: str) -> dict[str, CommitRecord]:
        """Layer -> newest commit of a shard, without the stale ones.

        A commit is stale when a layer that it was made from has another newest commit since, or
        is stale itself. Raises as `newest` does.
        """
        found: dict[str, CommitRecord] = {}
        for layer in self.layers:  # in the order of the stages, so upstream layers come first
            commit = self.newest(layer, shard)
            if commit is not None and all(
                name in found and found[name].hash == digest
                for name, digest in commit.upstream.items()
            ):
                found[layer] = commit
        return found
