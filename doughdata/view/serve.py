"""A whole dataset in the browser: a small server on this machine, with a scene picker.

All browsers that look at one server see the same scene and key frame.
"""

import contextlib
import html
import io
import math
import socket
import threading
from typing import Any

import numpy as np

from doughdata.registry import require_package
from doughdata.view.clouds import DepthWindow, depth_windows
from doughdata.view.projection import View
from doughdata.view.scene_data import SceneData, ViewDataset, load_scene, scene_title
from doughdata.view.served_layers import LAYERS, add_layer, depth_frame
from doughschemas import BadInputError, DoughError, TopologyEvent

__all__ = ["DatasetServer"]

TICK = 1 / 15  # [s], between two key frames of play
ABOUT = {
    "particles": "particles",
    "mesh": "component meshes",
    "tools": "gripper",
    "depth": "depth cloud",
    "graph": "scene graph",
}
NEEDS = {"mesh": "mesh", "depth": "depth", "graph": "topology"}  # layer -> entry of `missing`
SHORT = {"merge": "M", "split": "S", "self_merge": "m", "self_split": "s"}
MOST_EVENTS = 12  # told at once: those nearest to the key frame


class DatasetServer:
    """Serves a dataset from the moment it is made until `stop`; `run` waits and plays."""

    def __init__(
        self,
        dataset: ViewDataset,
        *,
        scene: int | None = None,
        sensor: str | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        """Start; a port in use gives way to the next free one (see `url`).

        Raises:
            BadInputError: an empty dataset, a scene or sensor that is not there, or a host that is
                not this machine's.
            MissingPackageError: viser is not installed.
        """
        viser: Any = require_package("viser", extra="serve")
        first = next(iter(dataset.scene_indices), 0) if scene is None else scene
        data = load_scene(dataset, first, sensor=sensor)
        _check_host(host)
        self._dataset, self._sensor = dataset, sensor
        self._lock = threading.RLock()
        self._nodes: dict[str, list[Any]] = {}
        self._stopped = threading.Event()
        self._host = host
        with contextlib.redirect_stdout(io.StringIO()):  # its banner; `url` says the same
            self._viser = viser.ViserServer(host=host, port=port, verbose=False)
        self._viser.gui.configure_theme(show_share_button=False, show_logo=False)
        self._viser.scene.set_up_direction("+z")
        self._add_controls(first)
        self._take(data)

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        return f"http://{self._host}:{self._viser.get_port()}"

    @property
    def scene_index(self) -> int:
        """Of the scene that is shown."""
        return self._data.index

    @property
    def frame(self) -> int:
        """The key frame that is shown."""
        return int(self._slider.value)

    def show(self, *, scene: int | None = None, frame: int | None = None) -> None:
        """Go to another scene or key frame, as the controls do.

        Raises:
            BadInputError: no such scene.
        """
        if scene is not None and scene != self.scene_index:
            self._take(load_scene(self._dataset, scene, sensor=self._sensor))
            self._picker.value = next(n for n, index in self._names.items() if index == scene)
        if frame is not None:
            self._slider.value = max(0, min(self._data.num_frames - 1, frame))

    def run(self) -> None:
        """Play, where it is asked for, until `stop` or Ctrl-C."""
        while not self._stopped.wait(TICK):
            if self._play.value:
                with self._lock:
                    self._slider.value = (self.frame + 1) % self._data.num_frames

    def stop(self) -> None:
        """Close the page's connection and give the port back. May be called again."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        with contextlib.redirect_stdout(io.StringIO()):  # viser says that it stopped
            self._viser.stop()

    def _add_controls(self, first: int) -> None:
        gui, scenes = self._viser.gui, self._dataset.scenes
        names = {
            f"{index} \N{MIDDLE DOT} {name}": index
            for index, name in zip(
                scenes["scene_index"].to_pylist(), scenes["scene_id"].to_pylist(), strict=True
            )
        }
        now = next(name for name, index in names.items() if index == first)
        self._names = names
        self._picker = gui.add_dropdown("scene", list(names), initial_value=now, order=0)
        self._play = gui.add_checkbox("play", initial_value=False, order=2)
        self._boxes = {}
        for number, layer in enumerate(LAYERS):
            box = gui.add_checkbox(ABOUT[layer], initial_value=False, order=3 + number)
            box.on_update(lambda _: self._refresh())
            self._boxes[layer] = box
        self._text = gui.add_html("", order=20)
        self._slider: Any = None
        self._picker.on_update(lambda _: self._pick())

    def _pick(self) -> None:
        """The dropdown was used; what cannot be shown is told and the old scene stays."""
        try:
            self.show(scene=self._names[self._picker.value])
        except DoughError as error:
            self._text.content = f"<p><b>cannot show this scene</b>: {html.escape(str(error))}</p>"

    def _take(self, data: SceneData) -> None:
        """Show another scene, from its first key frame."""
        with self._lock, self._viser.atomic():
            self._data = data
            self._windows: list[DepthWindow] = []
            if data.depth is not None:
                self._windows = depth_windows(data.depth, data.particles.positions)
            if self._slider is not None:
                self._slider.remove()
            self._slider = self._viser.gui.add_slider(
                "key frame",
                min=0,
                max=max(data.num_frames - 1, 1),
                step=1,
                initial_value=0,
                marks=_marks(data),
                order=1,
            )
            self._slider.on_update(lambda _: self._refresh())
            there = {layer: NEEDS.get(layer) not in data.missing for layer in LAYERS}
            wanted = {"tools", "graph", "mesh" if there["mesh"] else "particles"}
            started = any(box.value for box in self._boxes.values())
            for layer, box in self._boxes.items():
                box.disabled = not there[layer]
                box.value = there[layer] and (box.value if started else layer in wanted)
            self._aim()
            self._refresh()

    def _aim(self) -> None:
        """Grid and camera for the scene's dough, from where the contact sheet looks."""
        points = self._data.particles.positions.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) + 0.01
        eye = middle + View().axes[2] * 1.1 * size
        self._viser.scene.add_grid(
            "/table", width=4 * size, height=4 * size, cell_size=0.01, section_size=0.05,
            cell_color=(217, 212, 200), section_color=(190, 184, 170),
        )  # fmt: skip
        cameras = [self._viser.initial_camera]
        cameras += [client.camera for client in self._viser.get_clients().values()]
        for camera in cameras:
            camera.look_at, camera.position = middle, eye
            camera.near = size / 100

    def _refresh(self) -> None:
        """Draw the layers that are asked for, at the key frame of the slider."""
        with self._lock, self._viser.atomic():
            data, frame = self._data, min(self.frame, self._data.num_frames - 1)
            on = {layer for layer, box in self._boxes.items() if box.value}
            for node in (node for nodes in self._nodes.values() for node in nodes):
                node.remove()
            self._nodes = {
                layer: add_layer(
                    layer,
                    self._viser.scene,
                    data,
                    frame,
                    windows=self._windows,
                    glass=bool(on & {"particles", "graph"}),
                )
                for layer in on
            }
            self._text.content = _told(data, frame, depth_frame(self._windows, frame), on)


def _check_host(host: str) -> None:
    """Refuse a name that no server of this machine can have."""
    try:
        with socket.socket() as probe:
            probe.bind((host, 0))
    except OSError as error:
        raise BadInputError(
            f"cannot serve on host {host!r}: {error.strerror or error}; 127.0.0.1 is this machine "
            "alone, 0.0.0.0 its whole network"
        ) from error


def _marks(data: SceneData) -> tuple[tuple[int, str], ...]:
    """Letters under the slider where something happened."""
    events = data.topology.events if data.topology else ()
    letters: dict[int, list[str]] = {}
    for event in events:
        here, letter = letters.setdefault(event.frame, []), SHORT.get(event.kind, "?")
        if letter not in here:
            here.append(letter)
    return tuple((frame, "".join(here)) for frame, here in sorted(letters.items()))


def _told(data: SceneData, frame: int, depth: int, on: set[str]) -> str:
    """The text under the controls, as HTML; texts of the dataset are escaped."""
    poses, seconds = data.particles.tool_poses, data.particles.timestamps[frame]
    lines = [
        html.escape(scene_title(data.index, data.scene)),
        f"{seconds:.3f} s, opening {1000 * poses.opening[frame]:.1f} mm",
    ]
    if data.topology:
        topology = data.topology.frames[frame]
        genus = ", ".join(map(str, topology.genus)) or "none"
        lines.append(f"<b>c = {topology.num_components}, g = {genus}</b>")
        if topology.ambiguous:
            lines.append(f"<b>ambiguous</b>: {html.escape(topology.ambiguous_reason)}")
        near = sorted(data.topology.events, key=lambda event: abs(event.frame - frame))
        lines += [_event(e) for e in sorted(near[:MOST_EVENTS], key=lambda event: event.frame)]
    if "depth" in on and depth != frame:
        lines.append(f"depth of key frame {depth}")
    lines += [f"<b>{html.escape(k)}</b>: {html.escape(v)}" for k, v in data.missing.items()]
    return "".join(f"<p style='margin: 0.3em 1em'>{line}</p>" for line in lines)


def _event(event: TopologyEvent) -> str:
    before, after = (
        ", ".join(map(str, labels)) or "none"
        for labels in (event.components_before, event.components_after)
    )
    margin = f", margin {event.margin:.2f}" if math.isfinite(event.margin) else ""
    kind = html.escape(event.kind.replace("_", "-"))
    return (
        f"key frame {event.frame}: {kind}, components {before} \N{RIGHTWARDS ARROW} {after}{margin}"
    )
