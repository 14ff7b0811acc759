"""What the numbers must satisfy (`validate --deep`): one method a layer."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from doughdata.dataset.commits import RECORDED, CommitRecord
from doughdata.dataset.contacts import CONTACT_COLUMNS
from doughdata.dataset.content_contacts import contact_problems
from doughdata.dataset.content_recorded import recorded_problems
from doughdata.dataset.content_sim import pose_problems, sim_problems
from doughdata.dataset.duplicates import leaking_groups
from doughdata.dataset.graphs import component_count, mesh_genus, mesh_volume, mesh_watertight
from doughdata.dataset.layers import decode_label_grid, decode_meshes, decode_topology
from doughdata.dataset.report import Problem
from doughdata.dataset.shards import LayerShard, ShardRows
from doughdata.dataset.store import Store
from doughschemas import (
    NO_COMPONENT,
    SEGMENT_COMPONENT,
    SEGMENT_NONE,
    SEGMENT_TABLE,
    SEGMENT_TOOL,
    STRAY,
    ComponentMesh,
    DoughError,
    FrameTopology,
    MissingPackageError,
)

__all__ = ["ContentCheck"]

VOLUME_TOLERANCE = 0.05  # of a scene's final meshes against its labelled particles
GENUS_AGREEMENT = 0.99  # share of the frames that a check is sure of
Problems = Iterator[Problem]


class ContentCheck:
    """Checks shard after shard and adds up the figures."""

    def __init__(self, store: Store, *, num_frames: int) -> None:
        self._store = store
        self.num_frames = num_frames
        self._frames = self._ambiguous = self._meshed = self._agree = 0
        self._sure = self._sure_agree = self._contacts_unchecked = 0
        self._volume_error = self._final_volume_error = 0.0
        self._disagree: list[tuple[int, int]] = []  # sure frames whose mesh has another genus

    def figures(self) -> dict[str, Any]:
        """Totals over all shards checked so far; shares are None where nothing was counted."""
        unchecked = self._contacts_unchecked  # scenes whose tools need a package that is not here
        return {
            "ambiguous_share": _share(self._ambiguous, self._frames),
            "mesh_genus_agreement": _share(self._agree, self._meshed),
            "mesh_genus_agreement_unambiguous": _share(self._sure_agree, self._sure),
            "volume_error_max": self._volume_error,
            "volume_error_max_final_frame": self._final_volume_error,
            **({"contacts_unchecked": unchecked} if unchecked else {}),
        }

    def dataset(self, scenes: pa.Table | None) -> Problems:
        """Problems that no shard shows by itself; to be asked when all shards were checked.

        `scenes` is the table of that name, None if it cannot be built.
        """
        if _share(self._sure_agree, self._sure) is not None and (
            self._sure_agree < GENUS_AGREEMENT * self._sure
        ):
            message = (
                f"meshes have another genus than their labels in {len(self._disagree)} of "
                f"{self._sure} key frames that the topology check is sure of"
            )
            yield Problem(file="data/mesh", message=message, frames=tuple(self._disagree))
        for group in leaking_groups([] if scenes is None else [scenes]):
            listed = ", ".join(f"{name} ({split})" for name, split in sorted(group.items()))
            message = f"near-duplicate scenes lie in different splits: {listed}"
            yield Problem(file="meta/scenes.parquet", message=message)

    def shard(self, commits: Mapping[str, CommitRecord], rows: ShardRows) -> Problems:
        """Problems of all layers of one shard. A layer that cannot be decoded gives one."""
        opened = {
            layer: LayerShard(self._store, commit, rows)
            for layer, commit in commits.items()
            if commit.path is not None
        }
        for layer, shard in opened.items():
            try:
                yield from self._decodes(shard)
                if layer in CONTACT_COLUMNS:
                    yield from self._contacts(shard, opened["sim"])
                if layer == "sim":
                    yield from sim_problems(shard)
                elif layer == "topology":
                    yield from self._topology(shard, opened["sim"])
                elif layer == "mesh":
                    yield from self._mesh(shard, opened)
                else:
                    yield from self._depth(shard)
                    if layer == RECORDED:
                        yield from recorded_problems(shard)
            except (DoughError, LookupError, ValueError, pa.ArrowException) as error:
                yield Problem(file=str(shard.commit.path), message=_one_line(error))

    def _decodes(self, shard: LayerShard) -> Problems:
        """Every chunk of every array; the tables are read by the checks of their layers."""
        for name in shard.array_names:
            array = shard.array(name)
            for chunk in range(array.num_chunks):
                array.read_chunk(chunk)
        for name in shard.table_names:
            if shard.table(name).table.schema.metadata is None:
                file = f"{shard.commit.path}/{name}.parquet"
                yield Problem(file=file, message="no schema_version")

    def _contacts(self, shard: LayerShard, sim: LayerShard) -> Problems:
        """Contacts against what the layers give; those of mesh tools need optional packages."""
        try:
            yield from contact_problems(self._store, shard, sim)
        except MissingPackageError:
            self._contacts_unchecked += len(shard.commit.scenes)

    def _topology(self, shard: LayerShard, sim: LayerShard) -> Problems:
        counts = sim.array("num_particles").all()
        for index in shard.commit.scenes:
            count = int(counts[shard.rows.start(index)])
            topology = decode_topology(shard, index, num_particles=count)
            wrong: dict[str, list[tuple[int, int]]] = {}
            for k, frame in enumerate(topology.frames):
                self._frames += 1
                self._ambiguous += frame.ambiguous
                for message in _topology_faults(frame, count):
                    wrong.setdefault(message, []).append((index, k))
            for message, frames in wrong.items():
                yield Problem(file=str(shard.commit.path), message=message, frames=tuple(frames))
            bonds = [*topology.bonds_made, *topology.bonds_broken]
            if any(len(b) and (b.min() < 0 or b.max() >= count) for b in bonds):
                yield Problem(
                    file=f"{shard.commit.path}/bonds.parquet",
                    message=f"scene {index}: a bond names a particle that does not exist",
                )

    def _mesh(self, shard: LayerShard, opened: Mapping[str, LayerShard]) -> Problems:
        file = str(shard.commit.path)
        frames = opened["topology"].table("frames")
        for index in shard.commit.scenes:
            table = frames.scene(index)
            genus, ambiguous = table["genus"].to_pylist(), table["ambiguous"].to_pylist()
            wrong: dict[str, list[tuple[int, int]]] = {}
            for k in range(self.num_frames):
                meshes = decode_meshes(shard, index, k)
                grid = decode_label_grid(shard, index, k).labels
                faults = list(_mesh_faults(meshes, len(genus[k])))
                if np.any((grid != NO_COMPONENT) & (grid >= len(genus[k]))):
                    faults.append("the label grid names a component that does not exist")
                error = self._volume(opened, index, k, meshes)
                if k == self.num_frames - 1 and error > VOLUME_TOLERANCE:
                    faults.append(f"mesh volume is {error:.1%} off the particles' volume")
                for message in faults:
                    wrong.setdefault(message, []).append((index, k))
                if not faults:
                    agree = [mesh_genus(mesh.faces) for mesh in meshes] == genus[k]
                    self._count_genus(agree, ambiguous[k], at=(index, k))
            for message, hit in wrong.items():
                yield Problem(file=file, message=message, frames=tuple(hit))

    def _depth(self, shard: LayerShard) -> Problems:
        file = str(shard.commit.path)
        views, depth = shard.table("views").table, shard.array("depth")
        segments = shard.array("segments")
        if len(views) != depth.shape[0] or depth.shape != segments.shape:
            yield Problem(file=file, message="views, depth and segments must have as many rows")
            return
        known = np.zeros(256, bool)
        known[[SEGMENT_NONE, SEGMENT_TABLE, SEGMENT_TOOL]] = True
        known[SEGMENT_COMPONENT:] = True
        scene, frame = (views[c].to_numpy() for c in ("scene_index", "frame_index"))
        bad = [row for row in range(len(views)) if not known[segments.row(row)].all()]
        if bad:
            hit = tuple((int(scene[row]), int(frame[row])) for row in bad)
            yield Problem(file=file, message="segments must be SEGMENT_* values", frames=hit)
        sizes = {(row["height"], row["width"]) for row in views.to_pylist()}
        if sizes - {depth.shape[1:]}:
            yield Problem(file=file, message="the cameras' size is not the images' size")
        yield from pose_problems(views, f"{file}/views.parquet")

    def _volume(
        self,
        opened: Mapping[str, LayerShard],
        scene: int,
        frame: int,
        meshes: tuple[ComponentMesh, ...],
    ) -> float:
        """Relative error of the total mesh volume; the largest is kept as a figure."""
        sim, rows = opened["sim"], opened["sim"].rows
        row = rows.start(scene) + frame
        count = int(sim.array("num_particles").row(row))
        labels = opened["topology"].array("labels").row(row)[:count]
        spacing = sim.table("scenes").scene(scene)["particle_spacing"][0].as_py()
        expected = np.count_nonzero(labels != STRAY) * spacing**3
        volume = sum(mesh_volume(mesh.vertices, mesh.faces) for mesh in meshes)
        error = float(abs(volume - expected) / expected) if expected else 0.0
        self._volume_error = max(self._volume_error, error)
        if frame == self.num_frames - 1:
            self._final_volume_error = max(self._final_volume_error, error)
        return error

    def _count_genus(self, agree: bool, ambiguous: bool, *, at: tuple[int, int]) -> None:
        self._meshed += 1
        self._agree += agree
        if not ambiguous:
            self._sure += 1
            self._sure_agree += agree
            if not agree:
                self._disagree.append(at)


def _topology_faults(frame: FrameTopology, count: int) -> Iterator[str]:
    """What a frame's labels, contacts and scene graph must satisfy."""
    present = np.unique(frame.labels[frame.labels != STRAY])
    if not np.array_equal(present, np.arange(frame.num_components)):
        yield "labels must be 0..num_components-1, each with a particle, or 255"
    if len(frame.contacts) and (frame.contacts.min() < 0 or frame.contacts.max() >= count):
        yield "a contact names a particle that does not exist"
    graph, edges = frame.graph, frame.graph.edges
    nodes = len(graph.particles)
    if len(edges) and (edges.min() < 0 or edges.max() >= nodes):
        yield "an edge of the scene graph names a node that does not exist"
        return
    doubled = len(np.unique(np.sort(edges, axis=1), axis=0)) != len(edges)
    if doubled or np.any(edges[:, 0] == edges[:, 1]):
        yield "the scene graph must have no loops and no double edges"
    if np.any(graph.components[edges[:, 0]] != graph.components[edges[:, 1]]):
        yield "an edge of the scene graph joins two components"
        return
    for label, genus in enumerate(frame.genus):
        own = np.flatnonzero(graph.components == label)
        place = np.full(nodes, -1)
        place[own] = np.arange(len(own))
        mine = place[edges[graph.components[edges[:, 0]] == label]]
        parts = component_count(mine, len(own))
        if parts != 1 or len(mine) - len(own) + parts != genus:
            yield "a component of the scene graph must be connected, with its genus as cycle rank"
            return


def _mesh_faults(meshes: tuple[ComponentMesh, ...], count: int) -> Iterator[str]:
    if len(meshes) != count:
        yield "there must be one mesh a component"
    for mesh in meshes:
        if not _finite(mesh.vertices):
            yield "a mesh has vertices that are not finite"
        elif not mesh_watertight(mesh.faces, len(mesh.vertices)):
            yield "a mesh is not watertight"
        elif mesh_volume(mesh.vertices, mesh.faces) <= 0:
            yield "a mesh is turned inside out"


def _finite(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all())


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
