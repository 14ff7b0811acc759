"""The damages of real recordings, each made of the real recording that lies beside the tests."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from tests.recordings_damage import chunk_spans
from tests.recordings_made import ROS2

MUG = Path(__file__).parent / "data" / "recordings" / "red_mug.mcap"
COLLECTION = Path(__file__).parents[2] / "shared" / "recordings"  # beside a working copy
CHUNK = 100_000  # bytes, so that there are several chunks
BARE = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
Edit = Callable[[str, int, Any], Any]  # of (topic, number, message), None leaves it out


@dataclass(frozen=True, kw_only=True)
class _Raw:
    topic: str
    kind: str
    schema: bytes
    time: int
    data: bytes


def real_recordings() -> list[Path]:
    """The one in the repository, and those of the collection where it is there."""
    return [MUG, *sorted(COLLECTION.glob("*.mcap"))]


def _messages() -> Iterator[_Raw]:
    with MUG.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            yield _Raw(
                topic=channel.topic,
                kind=schema.name,
                schema=schema.data,
                time=message.log_time,
                data=message.data,
            )


def rewritten(path: Path, edit: Edit | None = None, **options: Any) -> Path:
    """The recording written again, in several chunks, with some messages changed by rosbags."""
    numbers: dict[str, int] = {}
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    options = {"chunk_size": CHUNK, "compression": CompressionType.ZSTD} | options
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2")
        for raw in _messages():
            number = numbers[raw.topic] = numbers.get(raw.topic, -1) + 1
            data = _edited(raw, number, edit)
            if data is None:
                continue
            if raw.kind not in schemas:
                schemas[raw.kind] = writer.register_schema(raw.kind, "ros2msg", raw.schema)
            if raw.topic not in channels:
                channels[raw.topic] = writer.register_channel(raw.topic, "cdr", schemas[raw.kind])
            writer.add_message(channels[raw.topic], raw.time, data, raw.time)
        writer.finish()
    return path


def _edited(raw: _Raw, number: int, edit: Edit | None) -> bytes | None:
    if edit is None or not ("image" in raw.topic or "info" in raw.topic):
        return raw.data
    message = edit(raw.topic, number, ROS2.deserialize_cdr(raw.data, raw.kind))
    return None if message is None else bytes(ROS2.serialize_cdr(message, raw.kind))


def _changed(path: Path, change: Callable[[bytearray, tuple[int, int]], None]) -> Path:
    """With other bytes, told where the second chunk lies."""
    data = bytearray(path.read_bytes())
    change(data, chunk_spans(bytes(data), path)[1])
    path.write_bytes(data)
    return path


def _wrong_crc(data: bytearray, chunk: tuple[int, int]) -> None:
    data[chunk[0] + 9 + 24] ^= 0xFF


def _unknown_compression(data: bytearray, chunk: tuple[int, int]) -> None:
    at = chunk[0] + 9 + 28
    assert data[at : at + 8] == b"\x04\0\0\0zstd"
    data[at + 4 : at + 8] = b"zst9"


def _without(part: str) -> Edit:
    def edit(topic: str, number: int, message: Any) -> Any:
        del number
        return None if part in topic else message

    return edit


def _depth(change: Callable[[np.ndarray], np.ndarray]) -> Edit:
    """Depth images with other pixels."""

    def edit(topic: str, number: int, message: Any) -> Any:
        if topic.endswith("compressedDepth"):
            data = bytes(message.data)
            pixels = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)
            body = cv2.imencode(".png", change(pixels))[1].tobytes()
            message.data = np.frombuffer(struct.pack("<iff", 0, 0, 0) + body, np.uint8)
        return message

    return edit


def _cut_png(topic: str, number: int, message: Any) -> Any:
    if topic.endswith("compressedDepth") and number == 1:
        message.data = message.data[: len(message.data) // 2]
    return message


def _cut(path: Path) -> Path:
    data = rewritten(path).read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    return path


def _packed(path: Path) -> Path:
    path.write_bytes(zstandard.compress(MUG.read_bytes()))
    return path


# Name of a sample -> what makes its like.
MAKE: dict[str, Callable[[Path], Path]] = {
    "00_ok_base.mcap": rewritten,
    "01_truncated_60pct.mcap": _cut,
    "06_no_summary_no_index.mcap": lambda path: rewritten(path, **BARE),
    "08_chunk_crc_mismatch.mcap": lambda path: _changed(rewritten(path), _wrong_crc),
    "09_unknown_compression.mcap": lambda path: _changed(rewritten(path), _unknown_compression),
    "20_no_camera_info.mcap": lambda path: rewritten(path, _without("info")),
    "22_no_depth.mcap": lambda path: rewritten(path, _without("compressedDepth")),
    "25_depth_half_size_of_colour.mcap": lambda path: rewritten(
        path, _depth(lambda pixels: np.ascontiguousarray(pixels[::2, ::2]))
    ),
    "26_zero_depth.mcap": lambda path: rewritten(path, _depth(np.zeros_like)),
    "33_one_depth_png_cut.mcap": lambda path: rewritten(path, _cut_png),
    "39_whole_file.mcap.zstd": _packed,
}
