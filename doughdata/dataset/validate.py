"""`validate`: is every byte what was written, and does the content keep its promises?"""

import json
from collections.abc import Callable, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import pyarrow as pa

from doughdata.dataset.assets import BODIES, TOOLS
from doughdata.dataset.commits import RECORDED, CommitLog, CommitRecord, list_layers, read_commit
from doughdata.dataset.content import ContentCheck
from doughdata.dataset.damage import damaged_frames
from doughdata.dataset.describe import check_documents
from doughdata.dataset.documents import load_document
from doughdata.dataset.info import INFO, read_info
from doughdata.dataset.plan import PlanRecord, read_plans, shards_of
from doughdata.dataset.reader import command_for
from doughdata.dataset.report import Problem, Report
from doughdata.dataset.shards import ShardRows, read_table
from doughdata.dataset.store import Store, store_of
from doughdata.dataset.supplements import SUPPLEMENTS, read_supplement
from doughdata.dataset.tables import build_info, build_tables
from doughdata.dataset.transfer import ORIGIN
from doughschemas import DamagedDatasetError, DoughError
from doughschemas.json_schemas import read_json_schema
from doughschemas.migrate import is_newer

__all__ = ["validate"]

KNOWN_FOR_EVER = ("fingerprint", "splits", "total_failed", "total_frames", "total_scenes")
Problems = Iterator[Problem]
Progress = Callable[[int, int], None]  # shards done, shards in all


def validate(
    uri: str | Path | Store, *, deep: bool = False, on_progress: Progress | None = None
) -> Report:
    """Check a dataset.

    Always: documents against their JSON schemas and checksums, the sha256 and presence of every
    committed file, no strangers among them, no stale layers, derived tables equal to a rebuild.
    `deep`: every chunk and table is decoded as well and the content is checked (closed meshes,
    volumes, labels, scene graphs, poses, images); damaged files name the key frames they hit.

    Raises:
        DatasetError: there is no dataset at all.
        VersionError: a schema that this release cannot read.
    """
    store = store_of(uri)
    if not store.exists(INFO):
        read_info(store)  # says why there is no dataset
    check = _Validation(store, deep=deep)
    problems = list(check.run(on_progress or _silent))
    return Report(problems=tuple(problems), figures=check.figures)


class _Validation:
    """One run; what a step finds out is kept for the next."""

    def __init__(self, store: Store, *, deep: bool) -> None:
        self._store, self._deep = store, deep
        self._damaged: set[str] = set()  # files that were reported
        self._scenes: pa.Table | None = None  # what the commits give, unless they are damaged
        self.figures: dict[str, Any] = {"files": 0, "bytes": 0, "orphans": 0}

    def run(self, progress: Progress) -> Problems:
        """All problems, in the order of the checks."""
        info = None
        try:
            info = read_info(self._store)
        except DoughError as error:
            yield self._problem(INFO, error)
        else:
            yield from self._schema("info", INFO, info)
        plans = yield from self._plans()
        commits = yield from self._commits()
        log = CommitLog(self._store)
        try:
            fresh = {shard: log.fresh(shard) for shard in log.shards}
        except DoughError:
            return  # a damaged commit was reported; without it nothing below can be judged
        yield from self._places(plans, commits)
        yield from self._supplements(commits)
        if self._store.exists(ORIGIN):
            yield from self._document("origin", ORIGIN)
        yield from self._files(commits)
        yield from self._assets()
        yield from self._stale(log, fresh)
        if info is None:
            return
        yield from self._tables(info, log)
        yield from check_documents(self._store, info)
        content = ContentCheck(self._store, num_frames=info["num_frames"])
        for done, shard in enumerate(log.shards if self._deep else ()):
            progress(done, len(log.shards))
            yield from self._content(content, fresh[shard])
        if self._deep:
            yield from content.dataset(self._scenes)
            progress(len(log.shards), len(log.shards))
            self.figures |= content.figures()

    def _schema(self, kind: str, name: str, document: Mapping[str, Any]) -> Problems:
        """Compare with the JSON schema; only the first difference is told."""
        import jsonschema

        validator = jsonschema.Draft202012Validator(read_json_schema(kind))
        for error in validator.iter_errors(document):
            place = "/".join(map(str, error.absolute_path)) or "document"
            yield Problem(file=name, message=f"{place}: {error.message}")
            return

    def _plans(self) -> Iterator[Any]:
        """Plan records and the user-written scenes they name; returns the records."""
        for file in self._store.names("meta/plans"):
            name = f"meta/plans/{file}"
            document = yield from self._document("plan", name)
            path = (document or {}).get("scenes_path")
            if path is None:
                continue
            try:
                data = self._store.read(path)
            except DoughError as error:
                yield self._problem(path, error)
                continue
            if sha256(data).hexdigest() not in path:
                yield Problem(file=path, message="does not fit the sha256 in its name")
                continue
            for scene in json.loads(data):
                yield from self._schema("scene", path, scene)
        try:
            return read_plans(self._store)
        except DoughError as error:
            if not self._damaged:
                yield self._problem("meta/plans", error)
            return []

    def _commits(self) -> Iterator[Any]:
        """Every revision of every commit record; returns those that can be read."""
        found = []
        for layer in list_layers(self._store):
            for file in self._store.names(f"meta/commits/{layer}"):
                name = f"meta/commits/{layer}/{file}"
                document = yield from self._document("commit", name)
                if document is None:
                    continue
                commit = read_commit(self._store, layer, *_shard_and_revision(file))
                if commit.name != name:
                    yield Problem(file=name, message=f"claims to be {commit.name}")
                else:
                    found.append(commit)
        return found

    def _document(self, kind: str, name: str) -> Iterator[Any]:
        """A checked document, or None."""
        try:
            document = load_document(self._store.read(name), name=name)
        except DoughError as error:
            yield self._problem(name, error)
            return None
        wrong = list(self._schema(kind, name, document))
        yield from wrong
        return None if wrong else document

    def _supplements(self, commits: list[CommitRecord]) -> Problems:
        """What was added to a commit belongs to one that exists and fits its table."""
        known = {commit.name: commit for commit in commits}
        for layer in self._store.names(SUPPLEMENTS):
            for file in self._store.names(f"{SUPPLEMENTS}/{layer}"):
                name = f"{SUPPLEMENTS}/{layer}/{file}"
                if (yield from self._document("supplement", name)) is None:
                    continue
                commit = known.get(f"meta/commits/{layer}/{file}")
                if commit is None:
                    yield Problem(file=name, message="belongs to a commit that does not exist")
                    continue
                try:
                    read_supplement(self._store, commit)
                except DoughError as error:
                    yield self._problem(name, error)

    def _places(self, plans: list[PlanRecord], commits: list[CommitRecord]) -> Problems:
        """Every commit belongs to a planned shard and covers scenes of that shard only."""
        planned = {shard.id: set(shard.scene_indices) for p in plans for shard in shards_of(p)}
        for commit in commits:
            covered = set(commit.scenes) | set(commit.failed)
            if plans and not covered <= planned.get(commit.shard, set()):
                message = f"scenes {sorted(covered)} are not all planned for shard {commit.shard}"
                yield Problem(file=commit.name, message=message)

    def _files(self, commits: list[CommitRecord]) -> Problems:
        """Presence and sha256 of all files of all commits; strangers; orphans are counted."""
        by_path = {commit.path: commit for commit in commits if commit.path is not None}
        newest = {(c.layer, c.shard): c.revision for c in sorted(commits, key=lambda c: c.revision)}
        for path, commit in by_path.items():
            superseded = commit.revision < newest[commit.layer, commit.shard]
            there = set(self._store.walk(path)) if self._store.exists(path) else set()
            for name in sorted(there - set(commit.files)):
                yield Problem(file=f"{path}/{name}", message="is not named by the commit")
            # What is superseded may have been collected, on an object store also in part.
            for name in sorted(there & set(commit.files) if superseded else commit.files):
                yield from self._file(commit, f"{path}/{name}", name)
        for layer in self._store.names("data"):
            for attempt in self._store.names(f"data/{layer}"):
                self.figures["orphans"] += f"data/{layer}/{attempt}" not in by_path

    def _assets(self) -> Problems:
        """Meshes of tools and bodies are named by their sha256."""
        for folder in (TOOLS, BODIES):
            for name in self._store.names(folder.rstrip("/")):
                digest = sha256(self._store.read(folder + name)).hexdigest()
                if digest != name.partition(".")[0]:
                    message = "does not fit the sha256 in its name"
                    yield Problem(file=folder + name, message=message)

    def _file(self, commit: CommitRecord, path: str, name: str) -> Problems:
        try:
            data = self._store.read(path)
        except DamagedDatasetError as error:
            yield self._problem(path, error)
            return
        self.figures["files"] += 1
        self.figures["bytes"] += len(data)
        if sha256(data).hexdigest() == commit.files[name]:
            return
        frames: tuple[tuple[int, int], ...] = ()
        if self._deep:
            frames = damaged_frames(self._store, commit, name)
        self._damaged.add(path)
        yield Problem(file=path, message="has changed since it was written (sha256)", frames=frames)

    def _stale(self, log: CommitLog, fresh: Mapping[str, Mapping[str, CommitRecord]]) -> Problems:
        for shard, layers in fresh.items():
            for layer in log.layers:
                commit = log.newest(layer, shard)
                if commit is not None and layer not in layers:
                    message = f"is stale, its upstream changed; renew it: `{command_for(layer)}`"
                    yield Problem(file=commit.name, message=message)

    def _tables(self, info: Mapping[str, Any], log: CommitLog) -> Problems:
        """Derived tables and totals against a rebuild."""
        try:
            tables = build_tables(self._store, log, info)
        except DoughError as error:
            if not self._damaged:
                yield self._problem("meta", error)
            return
        self._scenes = tables["scenes"]
        newer = is_newer(info["schema_version"], what=self._store.uri)
        advice = "is not what the commits give; the next `doughdata generate` rebuilds it"
        hashes = {}
        for name, expected in tables.items():
            path = f"meta/{name}.parquet"
            try:
                data = self._store.read(path)
                table = read_table(self._store, path)
            except DoughError as error:
                yield self._problem(path, error)
                continue
            hashes[name] = sha256(data).hexdigest()
            if hashes[name] != info["tables"].get(name):
                yield Problem(file=path, message="does not fit its sha256 in meta/info.json")
            elif not _same_table(table, expected, newer=newer):
                yield Problem(file=path, message=advice)
        rebuilt = build_info(info, log, tables, hashes)
        for key in sorted(KNOWN_FOR_EVER if newer else {*rebuilt} - {"tables"}):
            if rebuilt[key] != info.get(key):
                yield Problem(file=INFO, message=f"{key} {advice}")
        self.figures |= {k: info[k] for k in ("total_scenes", "total_frames", "total_failed")}

    def _content(self, content: ContentCheck, layers: Mapping[str, CommitRecord]) -> Problems:
        base = layers.get("sim") or layers.get(RECORDED)
        if base is None:
            return
        rows = ShardRows(scenes=base.scenes, num_frames=content.num_frames)
        for problem in content.shard(layers, rows):
            if not any(file.startswith(problem.file) for file in self._damaged):
                yield problem

    def _problem(self, path: str, error: Exception) -> Problem:
        self._damaged.add(path)
        text = str(error).removeprefix(f"{self._store.uri}: ")
        text = text.removeprefix(path).lstrip(": ")
        return Problem(file=path, message=text)


def _same_table(table: pa.Table, expected: pa.Table, *, newer: bool) -> bool:
    """Whether a stored table is what the commits give; a newer version may have more columns."""
    if table.schema.metadata != expected.schema.metadata:
        return False
    if not newer:
        return table.equals(expected)
    names = expected.column_names
    return {*names} <= {*table.column_names} and table.select(names).equals(expected)


def _silent(done: int, total: int) -> None:
    del done, total


def _shard_and_revision(file: str) -> tuple[str, int]:
    shard, revision, _ = file.split(".")
    return shard, int(revision)
