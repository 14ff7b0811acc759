"""The end of an MCAP file: what it says about itself, as far as that can be trusted."""

from dataclasses import dataclass, field
from typing import BinaryIO
from zlib import crc32

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

from doughdata.recordings.mcap_records import FRAME, MAGIC, DamageError, parsed

__all__ = ["Summary", "read_summary"]

FOOTER = 20  # bytes of a footer's content
TAIL = FRAME.size + FOOTER + len(MAGIC)
MOST_SUMMARY = 1 << 28  # bytes


@dataclass(slots=True)
class Summary:
    """What the footer leads to. Without a footer the file was cut short."""

    complete: bool = False  # the file ends as it should
    data_end: int | None = None  # where the data section must have ended; None = unknown
    statistics: Statistics | None = None
    chunks: list[int] = field(default_factory=list)  # offsets, rising
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    problem: str = ""  # why the summary was not used


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Summary of an open file of `size` bytes; damage in it is told, not raised."""
    summary = Summary()
    if size < len(MAGIC) + TAIL:
        return summary
    file.seek(size - TAIL)
    tail = file.read(TAIL)
    if not tail.endswith(MAGIC):
        return summary
    summary.complete = True
    try:
        opcode, length = FRAME.unpack_from(tail)
        if (opcode, length) != (Opcode.FOOTER, FOOTER):
            raise DamageError("no footer")
        footer = parsed(Footer, tail[FRAME.size : FRAME.size + FOOTER])
        start, end = footer.summary_start, size - TAIL
        if start == 0:  # there is none, which is allowed
            summary.data_end = end
            return summary
        if not len(MAGIC) <= start <= end or end - start > MOST_SUMMARY:
            raise DamageError("a footer that points nowhere")
        file.seek(start)
        data = file.read(end - start)
        if footer.summary_crc not in (0, crc32(data + tail[: FRAME.size + 16])):
            raise DamageError("a summary that does not fit its CRC")
        _take(summary, data)
        summary.data_end = start
    except DamageError as error:
        return Summary(complete=True, problem=str(error))
    return summary


def _take(summary: Summary, data: bytes) -> None:
    """Fill in the records of a summary section."""
    place = 0
    while place < len(data):
        if place + FRAME.size > len(data):
            raise DamageError("a summary that ends in the middle of a record")
        opcode, length = FRAME.unpack_from(data, place)
        place += FRAME.size
        if length > len(data) - place:
            raise DamageError("a summary that ends in the middle of a record")
        content = data[place : place + length]
        place += length
        if opcode == Opcode.STATISTICS:
            summary.statistics = parsed(Statistics, content)
        elif opcode == Opcode.CHUNK_INDEX:
            summary.chunks.append(parsed(ChunkIndex, content).chunk_start_offset)
        elif opcode == Opcode.SCHEMA:
            schema = parsed(Schema, content)
            summary.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parsed(Channel, content)
            summary.channels[channel.id] = channel
    summary.chunks.sort()
