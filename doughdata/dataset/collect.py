"""Removing what no reader can reach any more: orphans of crashes, and superseded revisions."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from doughdata.dataset.commits import (
    UPSTREAM,
    CommitRecord,
    all_revisions,
    list_layers,
    read_commit,
)
from doughdata.dataset.info import read_info, refuse_newer
from doughdata.dataset.store import LocalStore, Store, store_of

__all__ = ["Collected", "collect"]

GRACE = 24 * 3600.0  # [s]; longer than any writer works on one shard or a reader keeps one open


@dataclass(frozen=True, slots=True, kw_only=True)
class Collected:
    """What `collect` removed, or would remove; paths are relative to the dataset."""

    orphans: tuple[str, ...]  # attempts that no commit names
    superseded: tuple[str, ...]  # attempts of commits that a newer revision replaced
    temporary: tuple[str, ...]  # files that a crash left unpublished
    young: int  # the same kinds, but younger than the grace period: kept


def collect(uri: str | Path | Store, *, grace: float = GRACE, dry_run: bool = False) -> Collected:
    """Remove attempts without a commit and attempts of superseded revisions.

    Commit records stay, also those of superseded revisions. Nothing is removed whose newest file,
    or whose successor's commit, is younger than `grace` seconds: a writer may still be at work on
    it, or a reader have it open. With a grace period of 0 no other process may use the dataset.

    Raises:
        DatasetError: there is no dataset, or the medium refuses.
        DamagedDatasetError: a commit record is damaged; nothing was removed.
        VersionError: a newer release made the dataset, and may have layers of its own.
    """
    store = store_of(uri)
    refuse_newer(store.uri, read_info(store))
    # Attempts first, commits second: what is committed in between is seen as committed.
    attempts = list(_attempts(store))
    temporary = store.temporaries("") if isinstance(store, LocalStore) else []
    commits = list(_commits(store))
    named = {commit.path for commit in commits if commit.path is not None}
    successors = dict(_superseded(commits))
    now = time.time()
    candidates = {
        "orphans": {path: path for path in attempts if path not in named},
        "superseded": {path: successors[path] for path in attempts if path in successors},
        "temporary": {path: path for path in temporary},
    }
    old = {
        kind: [path for path, dated_by in paths.items() if now - store.modified(dated_by) >= grace]
        for kind, paths in candidates.items()
    }
    for path in () if dry_run else [path for paths in old.values() for path in paths]:
        store.remove(path)
    young = sum(map(len, candidates.values())) - sum(map(len, old.values()))
    return Collected(**{kind: tuple(paths) for kind, paths in old.items()}, young=young)


def _attempts(store: Store) -> Iterator[str]:
    for layer in store.names("data"):
        if layer.partition(".")[0] not in UPSTREAM:
            continue  # not ours: a reader must ignore it, and so must we
        for attempt in store.names(f"data/{layer}"):
            yield f"data/{layer}/{attempt}"


def _commits(store: Store) -> Iterator[CommitRecord]:
    """Every revision of every commit record, each shard's in rising order."""
    for layer in list_layers(store):
        for shard, revisions in all_revisions(store, layer).items():
            for revision in revisions:
                yield read_commit(store, layer, shard, revision)


def _superseded(commits: list[CommitRecord]) -> Iterator[tuple[str, str]]:
    """Attempt of each superseded commit -> record of the commit that replaced it."""
    for commit, after in pairwise(commits):
        replaced = (commit.layer, commit.shard) == (after.layer, after.shard)
        if replaced and commit.path is not None:
            yield commit.path, after.name
