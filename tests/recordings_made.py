"""Recordings whose content is known in closed form, serialised by rosbags and Foxglove's types."""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags.typesys import Stores, get_typestore

from doughdata.exporters import foxglove
from doughdata.geometry import pixel_rays, quaternion_to_matrix
from doughdata.recordings.rvl import encode_rvl
from doughdata.render.cameras import look_at
from doughschemas import Camera, Intrinsics

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
LENS = Intrinsics(width=160, height=120, fx=150.0, fy=152.0, cx=79.0, cy=60.5)
CAMERA = look_at(LENS, (0.03, 0.33, 0.31), (0.0, 0.0, 0.0))
START = 1_700_000_000_000_000_000  # [ns]
PERIOD = 33_333_333  # [ns]
OFFSET = 7_300_000  # [ns], of depth behind colour
RADIUS, HALF = 0.012, 0.03  # [m], of the rolls: capsules, radius and half length of the middle
RED, WOOD = (200, 30, 25), (150, 120, 90)
DEPTH, COLOR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"
INFO = "/camera/aligned_depth_to_color/camera_info"
OPTICAL = "camera_color_optical_frame"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """An ideal image."""

    depth: np.ndarray  # [m], 0 = nothing
    color: np.ndarray  # RGB
    roll: np.ndarray  # -1 = table, else which roll


def rolls_picture(
    camera: Camera = CAMERA, *, gap: float = 0.012, turn: float = 0.0, count: int = 2
) -> Picture:
    """Rolls side by side on a table, `gap` [m] apart, turned by `turn` [rad] about z."""
    k = camera.intrinsics
    rays = pixel_rays(k) @ quaternion_to_matrix(np.array(camera.quaternion)).T
    origin = np.array(camera.position)
    depth = np.where(rays[..., 2] < 0, -origin[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    roll = np.full(depth.shape, -1)
    c, s = np.cos(turn), np.sin(turn)
    for number in range(count):
        x = (RADIUS + gap / 2) * (2 * number - 1) if count == 2 else 0.0
        hit = _capsule(origin, rays, np.array([c * x, s * x, RADIUS]), np.array([-s, c, 0.0]))
        roll[hit < depth] = number
        depth = np.minimum(depth, hit)
    depth = np.where(np.isfinite(depth) & (depth < 2.0), depth, 0.0)
    color = np.where((roll >= 0)[..., None], RED, WOOD).astype(np.uint8)
    return Picture(depth=depth, color=color, roll=roll)


def _capsule(o: np.ndarray, d: np.ndarray, middle: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Distance along rays o + t d to a capsule, in units of d; infinity for a miss."""
    p = o - middle
    along, rest = d @ axis, p @ axis
    flat, across = d - along[..., None] * axis, p - rest * axis
    hit = _root((flat**2).sum(-1), (flat * across).sum(-1), across @ across - RADIUS**2)
    best = np.where(np.abs(rest + hit * along) <= HALF, hit, np.inf)
    for end in (-HALF, HALF):
        q = p - end * axis
        best = np.minimum(best, _root((d**2).sum(-1), d @ q, q @ q - RADIUS**2))
    return best


def _root(a: np.ndarray, b: np.ndarray, c: float) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        root = (-b - np.sqrt(b * b - a * c)) / a
    return np.where(np.isfinite(root) & (root > 0), root, np.inf)


@dataclass(kw_only=True)
class Recording:
    """What a recording should be like; `write_*` makes it."""

    pictures: list[Picture] = field(default_factory=lambda: [rolls_picture()] * 3)
    depth: str = "16UC1"  # 16UC1 | 32FC1 | mono16 | png | rvl | png32
    color: str | None = "rgb8"  # raw encoding, jpeg, png, or None
    padding: int = 0  # bytes behind each row
    big_endian: bool = False
    info: bool = True
    lens: Intrinsics = LENS
    frames: tuple[str, str] = (OPTICAL, OPTICAL)  # ids of depth and colour
    stamped: bool = True
    gripper: bool = False
    edit: Callable[[str, int, Any], Any] | None = None  # of (topic, number, message)

    def messages(self, store: Any) -> Iterable[tuple[str, str, int, Any]]:
        """Topic, type, time of logging [ns] and message, by time."""
        make = store.types
        for number, picture in enumerate(self.pictures):
            at = START + number * PERIOD
            for topic, kind, stamp, message in self._of(make, picture, number, at):
                edited = self.edit(topic, number, message) if self.edit else message
                if edited is not None:
                    yield topic, kind, stamp + 2_000_000, edited

    def _of(self, make: Any, picture: Picture, number: int, at: int) -> Iterable[tuple]:
        if self.color is not None:
            yield self._color(make, picture, self._header(make, at, self.frames[1], number))
        if self.gripper:
            header = self._header(make, at, "", number)
            kind = "sensor_msgs/msg/JointState"
            numbers = (np.array([7.0, 0.05 - 0.01 * number]), np.zeros(2), np.zeros(2))
            yield "/joints", kind, at, make[kind](header, ["elbow", "width"], *numbers)
        at += OFFSET
        header = self._header(make, at, self.frames[0], number)
        yield self._depth(make, picture, header)
        if self.info:
            yield INFO, "sensor_msgs/msg/CameraInfo", at, self._info(make, header)

    def _header(self, make: Any, at: int, frame: str, number: int) -> Any:
        self._at = at
        time = divmod(at, 10**9) if self.stamped else (0, 0)
        stamp = make["builtin_interfaces/msg/Time"](*time)
        kind = make["std_msgs/msg/Header"]
        if "seq" in kind.__dataclass_fields__:
            return kind(number, stamp, frame)
        return kind(stamp, frame)

    def _depth(self, make: Any, picture: Picture, header: Any) -> tuple:
        units = np.rint(picture.depth * 1e3).astype(np.uint16)
        if self.depth in ("16UC1", "mono16"):
            return self._image(make, DEPTH, self.depth, units, header)
        if self.depth == "32FC1":
            metres = np.where(picture.depth > 0, picture.depth, np.nan).astype(np.float32)
            return self._image(make, DEPTH, self.depth, metres, header)
        head, form = struct.pack("<iff", 0, 0.0, 0.0), "16UC1; compressedDepth "
        if self.depth == "rvl":
            body = struct.pack("<II", *units.shape[::-1]) + encode_rvl(units.reshape(-1))
            form += "rvl"
        elif self.depth == "png":
            body, form = cv2.imencode(".png", units)[1].tobytes(), form + "png"
        else:
            a, b = 1000.0, 10.0
            with np.errstate(divide="ignore"):
                inverse = np.where(picture.depth > 0, np.rint(a / picture.depth + b), 0)
            body = cv2.imencode(".png", inverse.astype(np.uint16))[1].tobytes()
            head, form = struct.pack("<iff", 0, a, b), "32FC1; compressedDepth png"
        return self._compressed(make, f"{DEPTH}/compressedDepth", form, head + body, header)

    def _color(self, make: Any, picture: Picture, header: Any) -> tuple:
        pixels = picture.color
        if self.color in ("jpeg", "png"):
            data = cv2.imencode(f".{self.color}", pixels[..., ::-1])[1].tobytes()
            form = f"rgb8; {self.color} compressed bgr8"
            return self._compressed(make, f"{COLOR}/compressed", form, data, header)
        if self.color == "bgr8":
            pixels = pixels[..., ::-1]
        elif self.color == "mono8":
            pixels = pixels.mean(axis=-1).astype(np.uint8)
        elif self.color == "rgba8":
            pixels = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
        return self._image(make, COLOR, self.color or "", pixels, header)

    def _image(
        self, make: Any, topic: str, encoding: str, pixels: np.ndarray, header: Any
    ) -> tuple:
        if self.big_endian:
            pixels = pixels.astype(pixels.dtype.newbyteorder(">"))
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        rows = np.pad(rows, ((0, 0), (0, self.padding)), constant_values=77)
        height, width = pixels.shape[:2]
        message = make["sensor_msgs/msg/Image"](
            header, height, width, encoding, int(self.big_endian), rows.shape[1], rows.reshape(-1)
        )
        return topic, "sensor_msgs/msg/Image", self._at, message

    def _compressed(self, make: Any, topic: str, form: str, data: bytes, header: Any) -> tuple:
        kind = "sensor_msgs/msg/CompressedImage"
        return topic, kind, self._at, make[kind](header, form, np.frombuffer(data, np.uint8))

    def _info(self, make: Any, header: Any) -> Any:
        k = self.lens
        matrix = np.array([k.fx, 0, k.cx, 0, k.fy, k.cy, 0, 0, 1])
        full = np.array([k.fx, 0, k.cx, 0, 0, k.fy, k.cy, 0, 0, 0, 1, 0])
        roi = make["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        flat = (np.zeros(5), matrix, np.eye(3).reshape(-1), full)
        kind = make["sensor_msgs/msg/CameraInfo"]
        return kind(header, k.height, k.width, "plumb_bob", *flat, 0, 0, roi)


def write_mcap(
    path: Path,
    recording: Recording | None = None,
    *,
    ros: int = 2,
    chunk_size: int = 60_000,
    compression: CompressionType = CompressionType.ZSTD,
    **options: Any,
) -> Path:
    """An MCAP file in ROS 1 or ROS 2 serialisation; more options are the writer's."""
    store = ROS1 if ros == 1 else ROS2
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=compression, **options)
        writer.start(profile=f"ros{ros}")
        _write(writer, recording or Recording(), store, ros)
        writer.finish()
    return path


def _write(writer: Writer, recording: Recording, store: Any, ros: int) -> None:
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    serialise = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    for topic, kind, at, message in recording.messages(store):
        if kind not in schemas:
            text, _ = store.generate_msgdef(kind, ros_version=ros)
            name = kind.replace("/msg/", "/") if ros == 1 else kind
            schemas[kind] = writer.register_schema(name, f"ros{ros}msg", text.encode())
        if topic not in channels:
            encoding = "ros1" if ros == 1 else "cdr"
            channels[topic] = writer.register_channel(topic, encoding, schemas[kind])
        writer.add_message(channels[topic], at, bytes(serialise(message, kind)), at)


def write_foxglove(path: Path, pictures: list[Picture], *, unit: float | None = None) -> Path:
    """An MCAP file with Foxglove's schemas in Protobuf; depth in floats, or 16-bit units [m]."""
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for number, picture in enumerate(pictures):
            at = START + number * PERIOD
            units = np.rint(picture.depth / (unit or 1e-4)).astype(np.uint16)
            depth = foxglove.depth_image(at, "c", units, unit or 1e-4)
            if unit is not None:
                depth.encoding, depth.step, depth.data = "16UC1", 2 * LENS.width, units.tobytes()
            writer.write_message("/c/info", foxglove.calibration(at, "c", LENS), at, at)
            writer.write_message("/c/depth", depth, at, at)
            writer.write_message("/c/color", foxglove.color_image(at, "c", picture.color), at, at)
    return path
