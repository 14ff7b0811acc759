"""The framing of MCAP: opcode, length, content; chunks are unpacked and verified.

The library parses the records. Its readers are not used, because they skip what they do not know
and read chunks of unknown compression as if they were plain: messages vanish without an error.
Source of the layout: the MCAP specification, version 0.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, TypeVar
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

__all__ = [
    "FRAME",
    "MAGIC",
    "MESSAGE_HEADER",
    "DamageError",
    "InnerRecord",
    "definition",
    "inner_records",
    "parsed",
    "parsed_chunk",
    "unpacked",
]

MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")  # opcode, length of the content
MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK_FIXED = 8 + 8 + 8 + 4 + 4 + 8  # a chunk's content without compression name and data
MOST_UNPACKED = 1 << 30  # bytes; a chunk that claims more is taken as damaged
Record = TypeVar("Record")


class DamageError(Exception):
    """Bytes that are not what they should be; says what, in a few words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InnerRecord:
    """A record inside an unpacked chunk: where its content lies."""

    opcode: int
    start: int
    length: int


class _StrictStream(ReadDataStream):
    """The library's stream returns fewer bytes at the end of the data; here that is an error."""

    def read(self, length: int) -> bytes:
        """Exactly `length` bytes."""
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def parsed(kind: type[Record], data: bytes) -> Record:
    """A record of the library from its content; bytes behind its last field are ignored.

    Raises:
        DamageError: too short, or text that is no UTF-8.
    """
    stream = _StrictStream(BytesIO(data))
    try:
        record = kind.read(stream)  # pyright: ignore[reportAttributeAccessIssue]
    except (EndOfFile, struct.error, ValueError, OverflowError, MemoryError) as error:
        raise DamageError(f"a damaged {kind.__name__} record") from error
    return record


def parsed_chunk(data: bytes) -> Chunk:
    """A chunk; its inner lengths must add up to the record's."""
    chunk = parsed(Chunk, data)
    if CHUNK_FIXED + len(chunk.compression.encode()) + len(chunk.data) != len(data):
        raise DamageError("a chunk whose lengths contradict each other")
    return chunk


def unpacked(chunk: Chunk) -> bytes:
    """The records of a chunk, decompressed, with length and CRC verified.

    Raises:
        DamageError: unknown compression, data that cannot be decompressed, wrong CRC.
    """
    size = chunk.uncompressed_size
    if size > MOST_UNPACKED:
        raise DamageError(f"a chunk that claims to hold {size} bytes")
    try:
        data = _decompressed(chunk.compression, chunk.data, size)
    except DamageError:
        raise
    except Exception as error:  # each codec has its own exceptions
        raise DamageError(f"a chunk whose {chunk.compression} data is damaged") from error
    if len(data) != size:
        raise DamageError("a chunk of another size than it says")
    if chunk.uncompressed_crc not in (0, crc32(data)):
        raise DamageError("a chunk that does not fit its CRC")
    return data


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """At most `size` + 1 bytes, whatever the data claim."""
    if compression == "":
        return data
    if compression == "zstd":
        import zstandard

        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed not in (zstandard.CONTENTSIZE_UNKNOWN, size):
            raise DamageError("a chunk of another size than it says")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
    if compression == "lz4":
        import lz4.frame

        unpacker: Any = lz4.frame.LZ4FrameDecompressor()
        return unpacker.decompress(data, max_length=size + 1)
    raise DamageError(f"a chunk of unknown compression {compression[:20]!r}")


def inner_records(data: bytes) -> Iterator[InnerRecord]:
    """Records of an unpacked chunk.

    Raises:
        DamageError: a record that reaches beyond the chunk, or one that has no place in it.
    """
    place, end = 0, len(data)
    while place < end:
        if place + FRAME.size > end:
            raise DamageError("a chunk that ends in the middle of a record")
        opcode, length = FRAME.unpack_from(data, place)
        place += FRAME.size
        if length > end - place:
            raise DamageError("a chunk that ends in the middle of a record")
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            raise DamageError(f"a record of kind 0x{opcode:02x} inside a chunk")
        if opcode == Opcode.MESSAGE and length < MESSAGE_HEADER.size:
            raise DamageError("a message shorter than its own header")
        yield InnerRecord(opcode=opcode, start=place, length=length)
        place += length


def definition(opcode: int, data: bytes) -> Schema | Channel:
    """A schema or channel record."""
    return parsed(Schema if opcode == Opcode.SCHEMA else Channel, data)
