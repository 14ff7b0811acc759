"""One pass over an MCAP file: where every readable message lies, and what cannot be read.

The pass goes from record to record through the whole file, also where an index exists: an index
does not say whether the bytes it points to are whole. Memory grows with the number of messages
(about 30 bytes each), not with their size.
"""

import os
import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Header, Schema

from doughdata.recordings.mcap_records import (
    FRAME,
    MAGIC,
    MESSAGE_HEADER,
    DamageError,
    definition,
    inner_records,
    parsed,
    parsed_chunk,
    unpacked,
)
from doughdata.recordings.mcap_summary import Summary, read_summary

__all__ = ["Index", "McapScan", "scan_mcap"]

MOST_RECORD = 1 << 30  # bytes; a longer chunk or message is taken as a damaged length
SKIPPED = (Opcode.ATTACHMENT, Opcode.METADATA)
BLOCK = 1 << 20


class Index:
    """Where messages lie. `chunk` is the file offset of a chunk's content, 0 = not in a chunk."""

    def __init__(self) -> None:
        self.channel, self.log_time = array("H"), array("Q")
        self.chunk, self.start, self.length = array("Q"), array("Q"), array("Q")

    def __len__(self) -> int:
        return len(self.channel)

    def add(self, header: tuple[int, int, int, int], chunk: int, start: int, length: int) -> None:
        """Add a message whose data begin at `start` of the file or of the unpacked chunk."""
        self.channel.append(header[0])
        self.log_time.append(header[2])
        self.chunk.append(chunk)
        self.start.append(start)
        self.length.append(length)


@dataclass(slots=True)
class McapScan:
    """What a pass found."""

    index: Index = field(default_factory=Index)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunk_lengths: dict[int, int] = field(default_factory=dict)  # of good chunks, by content offset
    damage: list[str] = field(default_factory=list)  # in the order of the file
    warnings: list[str] = field(default_factory=list)
    expected: int | None = None  # messages by the file's own statistics
    unchecked: int = 0  # messages that no checksum covers


def scan_mcap(path: Path, on_progress: Callable[[int, int], None]) -> McapScan:
    """Read a whole file.

    Raises:
        DamageError: it is no MCAP file at all.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise DamageError("no MCAP file")
        scan = _Pass(file, size, read_summary(file, size), on_progress)
        scan.run()
    return scan.found


class _Pass:
    def __init__(
        self, file: BinaryIO, size: int, summary: Summary, on_progress: Callable[[int, int], None]
    ) -> None:
        self.file, self.size, self.summary = file, size, summary
        self.found, self.on_progress = McapScan(), on_progress
        self._end = size if summary.data_end is None else summary.data_end
        self._unknown = 0  # records of a kind that the format leaves to others

    def run(self) -> None:
        """Go through the data section; after damage go on at the next chunk that is known."""
        place: int | None = len(MAGIC)
        while place is not None:
            try:
                place = self._record(place)
            except DamageError as error:
                self.found.damage.append(f"byte {place}: {error}")
                place = next((start for start in self.summary.chunks if start > place), None)
            self.on_progress(place or self.size, self.size)
        self._conclude()

    def _record(self, place: int) -> int | None:
        """Take one record; returns where the next one starts, or None after the last."""
        self.file.seek(place)
        frame = self.file.read(FRAME.size)
        if len(frame) < FRAME.size or place >= self._end:
            raise DamageError("the recording was cut short")
        opcode, length = FRAME.unpack(frame)
        start = place + FRAME.size
        if length > self.size - start:
            cut = not self.summary.complete
            raise DamageError("the recording was cut short" if cut else "a record of wrong length")
        if opcode == Opcode.DATA_END:
            self._data_end(place, length)
            return None
        if opcode in SKIPPED or opcode >= 0x80:
            self._unknown += opcode >= 0x80
            return start + length
        if length > MOST_RECORD:
            raise DamageError("a record of wrong length")
        self._take(opcode, start, self.file.read(length))
        return start + length

    def _take(self, opcode: int, start: int, data: bytes) -> None:
        if opcode == Opcode.CHUNK:
            self._chunk(start, data)
        elif opcode == Opcode.MESSAGE:
            if len(data) < MESSAGE_HEADER.size:
                raise DamageError("a message shorter than its own header")
            header = MESSAGE_HEADER.unpack_from(data)
            self._message(header, 0, start, len(data))
            self.found.unchecked += 1
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(definition(opcode, data))
        elif opcode == Opcode.MESSAGE_INDEX:
            if len(data) < 6 or struct.unpack_from("<I", data, 2)[0] != len(data) - 6:
                raise DamageError("a damaged message index")
        elif opcode == Opcode.HEADER:
            parsed(Header, data)
        else:
            raise DamageError(f"a record of kind 0x{opcode:02x} among the data")

    def _chunk(self, start: int, data: bytes) -> None:
        """Index a chunk's messages; a bad one costs only itself, since its length is known."""
        try:
            chunk = parsed_chunk(data)
            inner = unpacked(chunk)
            records = list(inner_records(inner))
            for record in records:
                if record.opcode != Opcode.MESSAGE:
                    content = inner[record.start : record.start + record.length]
                    self._define(definition(record.opcode, content))
        except DamageError as error:
            self.found.damage.append(f"byte {start - FRAME.size}: {error}")
            return
        self.found.chunk_lengths[start] = len(data)
        for record in records:
            if record.opcode == Opcode.MESSAGE:
                self.found.unchecked += chunk.uncompressed_crc == 0
                header = MESSAGE_HEADER.unpack_from(inner, record.start)
                self._message(header, start, record.start, record.length)

    def _message(
        self, header: tuple[int, int, int, int], chunk: int, start: int, length: int
    ) -> None:
        fixed = MESSAGE_HEADER.size
        self.found.index.add(header, chunk, start + fixed, length - fixed)

    def _define(self, record: Schema | Channel) -> None:
        known = self.found.schemas if isinstance(record, Schema) else self.found.channels
        if known.setdefault(record.id, record) != record:  # pyright: ignore[reportArgumentType]
            name = type(record).__name__.lower()
            raise DamageError(f"{name} {record.id} is defined twice, differently")

    def _data_end(self, place: int, length: int) -> None:
        self.file.seek(place + FRAME.size)
        end = parsed(DataEnd, self.file.read(min(length, 64)))
        after = place + FRAME.size + length
        if length != 4 or (self.summary.data_end is not None and after != self.summary.data_end):
            raise DamageError("the data end too early")
        if end.data_section_crc:
            self.found.unchecked = 0
            if end.data_section_crc != self._crc(place):
                self.found.damage.append("the data do not fit their CRC")
        if self._another(after):
            self.found.damage.append("more bytes follow its end, another recording perhaps")

    def _another(self, place: int) -> bool:
        """Whether the magic bytes stand between the data's end and the file's end."""
        self.file.seek(place)
        left, before = self.size - len(MAGIC) - place, b""
        while left > 0:
            block = before + self.file.read(min(BLOCK, left))
            if MAGIC in block:
                return True
            left -= len(block) - len(before)
            before = block[1 - len(MAGIC) :]
        return False

    def _crc(self, stop: int) -> int:
        """CRC of the file's first bytes."""
        self.file.seek(0)
        value, left = 0, stop
        while left:
            block = self.file.read(min(BLOCK, left))
            value, left = crc32(block, value), left - len(block)
        return value

    def _conclude(self) -> None:
        """Compare with what the file says about itself."""
        found, summary = self.found, self.summary
        if not summary.complete and not found.damage:
            found.damage.append("the recording was cut short: its end is missing")
        if summary.problem:
            found.warnings.append(
                f"the recording's index is damaged ({summary.problem}); it was read without"
            )
        if found.unchecked:
            found.warnings.append(
                f"{found.unchecked} messages have no checksum: damage inside them is not noticed"
            )
        for kind in ("schemas", "channels"):
            for record in getattr(summary, kind).values():
                if getattr(found, kind).setdefault(record.id, record) != record:
                    found.damage.append(f"{kind[:-1]} {record.id} is not what the summary says")
        if summary.statistics is not None:
            found.expected = summary.statistics.message_count
            if found.expected != len(found.index) and not found.damage:
                found.damage.append(
                    f"{found.expected} messages were written by its own statistics, "
                    f"{len(found.index)} can be read"
                )
        elif self._unknown:
            found.damage.append(
                f"{self._unknown} records of a kind that is not in the format; "
                "without statistics nothing tells whether they were messages"
            )
        strangers = set(found.index.channel) - set(found.channels)
        if strangers:
            found.damage.append(f"messages of channel {min(strangers)}, which nothing describes")
