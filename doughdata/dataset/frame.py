"""One key frame of a scene, read part by part."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from doughdata.dataset.commits import RECORDED
from doughdata.dataset.contacts import FrameContacts
from doughdata.dataset.layers import (
    decode_color,
    decode_depth,
    decode_events,
    decode_frame_topology,
    decode_genus,
    decode_label_grid,
    decode_meshes,
)
from doughdata.dataset.shards import LayerShard
from doughschemas import (
    ComponentMesh,
    DepthViews,
    FrameTopology,
    LabelGrid,
    MissingLayerError,
    Tool,
    TopologyEvent,
)

if TYPE_CHECKING:
    from doughdata.dataset.reader import Dataset

__all__ = ["Frame", "FrameParticles", "FrameTools"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameParticles:
    """Material points of one key frame."""

    positions: Float32[np.ndarray, "particles 3"]  # [m], world
    object_ids: UInt8[np.ndarray, " particles"]  # index into `Scene.bodies`
    spacing: float  # [m]; one particle stands for spacing**3


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTools:
    """Both fingers at one key frame."""

    tool: Tool
    action: int  # index into `Scene.actions`
    position: Float64[np.ndarray, "fingers 3"]  # [m], finger frame's origin in the world
    quaternion: Float64[np.ndarray, "fingers 4"]  # xyzw, finger frame -> world
    opening: float  # [m]


class Frame:
    """A key frame. Every property raises MissingLayerError if its layer was not made."""

    def __init__(self, dataset: "Dataset", scene_index: int, frame_index: int) -> None:
        self._dataset = dataset
        self.scene_index, self.frame_index = scene_index, frame_index
        self._layers: dict[str, LayerShard] = {}

    def __repr__(self) -> str:
        return f"Frame(scene={self.scene_index}, frame={self.frame_index})"

    @cached_property
    def timestamp(self) -> float:
        """Seconds since the start of the first action; of a recording, since its first frame."""
        base = self._dataset.base_layer(self.scene_index)
        sim = self._dataset.layer(base, self.scene_index)
        frames = sim.table("frames")
        return float(frames.value("timestamp", frames.frame_rows(*self._key).start))

    @cached_property
    def particles(self) -> FrameParticles:
        """Layer `sim`."""
        sim = self._layer("sim")
        row = sim.rows.start(self.scene_index) + self.frame_index
        count = self._num_particles
        scenes = sim.table("scenes")
        at = scenes.scene_rows(self.scene_index).start
        return FrameParticles(
            positions=sim.array("positions").row(row)[:count],
            object_ids=sim.array("object_ids").row(row)[:count],
            spacing=float(scenes.value("particle_spacing", at)),
        )

    @cached_property
    def topology(self) -> FrameTopology:
        """Layer `topology`: labels, genus, scene graph, contacts."""
        shard = self._layer("topology")
        return decode_frame_topology(shard, *self._key, num_particles=self._num_particles)

    @cached_property
    def genus(self) -> tuple[int, ...]:
        """Layer `topology`: genus of each component; `topology` reads all that belongs to it."""
        return decode_genus(self._layer("topology"), *self._key)

    @cached_property
    def contacts(self) -> FrameContacts:
        """What touches what; from the layers `sim` and `topology`, None where one is missing.

        Raises:
            MissingLayerError: the scene was written in format 1.0; the message names the command.
        """
        return self._dataset.read_contacts(*self._key)

    @cached_property
    def events(self) -> tuple[TopologyEvent, ...]:
        """Changes of topology between the key frame before and this one."""
        shard = self._dataset.layer("topology", self.scene_index)
        events = decode_events(shard, self.scene_index)
        return tuple(event for event in events if event.frame == self.frame_index)

    @cached_property
    def meshes(self) -> tuple[ComponentMesh, ...]:
        """Layer `mesh`: mesh k belongs to component k."""
        return decode_meshes(self._layer("mesh"), *self._key)

    @cached_property
    def label_grid(self) -> LabelGrid:
        """Layer `mesh`: component of every node of a regular grid."""
        return decode_label_grid(self._layer("mesh"), *self._key)

    @cached_property
    def tools(self) -> FrameTools:
        """The gripper: which tool, and where both fingers are."""
        sim = self._layer("sim")
        frames, poses = sim.table("frames"), sim.table("tool_poses")
        at, here = frames.frame_rows(*self._key).start, poses.frame_rows(*self._key)
        frames.load(("action", "opening"), slice(at, at + 1))
        poses.load(("position", "quaternion"), here)
        scene = self._dataset.scene(self.scene_index)
        action = int(frames.value("action", at))
        return FrameTools(
            tool=scene.tools[scene.actions[action].tool],
            action=action,
            position=poses.values("position", here).copy(),
            quaternion=poses.values("quaternion", here).copy(),
            opening=float(frames.value("opening", at)),
        )

    def depth(self, sensor: str) -> DepthViews:
        """Layer `depth.<sensor>`: all views of this key frame.

        Raises:
            MissingLayerError: not rendered; the message names the command that does it.
        """
        views = decode_depth(self._layer(f"depth.{sensor}"), *self._key)
        if len(views.depth) == 0:
            raise MissingLayerError(
                f"{self._dataset.uri}: key frame {self.frame_index} of scene {self.scene_index} "
                f"has no depth view; make it with `doughdata render --noise {sensor} --all-frames`"
            )
        return views

    def color(self) -> UInt8[np.ndarray, "views rows columns 3"] | None:
        """RGB images of a recording's views; None if it had no colour.

        Raises:
            MissingLayerError: the scene was simulated, not recorded.
        """
        return decode_color(self._dataset.layer(RECORDED, self.scene_index), *self._key)

    def _layer(self, name: str) -> LayerShard:
        if name not in self._layers:
            self._layers[name] = self._dataset.layer(name, self.scene_index)
        return self._layers[name]

    @property
    def _key(self) -> tuple[int, int]:
        return self.scene_index, self.frame_index

    @cached_property
    def _num_particles(self) -> int:
        sim = self._layer("sim")
        return int(sim.array("num_particles").row(sim.rows.start(self.scene_index)))
