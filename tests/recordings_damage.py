"""Random damage to files, and whether what is read of them tells the truth."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from doughdata.recordings.mcap_source import McapSource
from doughschemas import DoughError

Content = Counter[tuple[str, int, bytes]]  # (topic, time of logging, data)


def content_of(path: Path) -> Content:
    """All messages of a whole file, by the standard reader."""
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages()
        return Counter((channel.topic, m.log_time, m.data) for _, channel, m in messages)


def chunk_spans(data: bytes, path: Path) -> list[tuple[int, int]]:
    """Where the chunks of a whole file lie: start and end of each record."""
    spans = []
    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True)
        for record in reader.records:
            if isinstance(record, Chunk):
                end = file.tell()
                size = 9 + 40 + len(record.compression) + len(record.data)
                spans.append((end - size, end))
    assert all(data[start] == 6 for start, _ in spans)
    return spans


def corrupted(data: bytes, spans: list[tuple[int, int]], rng: np.random.Generator) -> bytes:
    """Flipped bytes, a cut, a hole, doubled bytes, or two chunks that changed places."""
    kind = rng.integers(6)
    if kind <= 1:
        out = bytearray(data)
        for place in rng.integers(len(data), size=1 if kind == 0 else rng.integers(2, 20)):
            out[place] ^= int(rng.integers(1, 256))
        return bytes(out)
    a, b = sorted(rng.integers(len(data) + 1, size=2).tolist())
    if kind == 2:
        return data[:a]
    if kind == 3:
        b = min(b, a + int(rng.integers(1, 4096)))
        return data[:a] + data[b:]
    if kind == 4:
        b = min(b, a + int(rng.integers(1, 4096)))
        return data[:b] + data[a:]
    if len(spans) < 2:
        return data[:-1]
    (a, b), (c, d) = sorted(spans[k] for k in rng.choice(len(spans), 2, replace=False))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def chunk_contents(path: Path) -> list[Content]:
    """Messages of each chunk of a whole file, by the standard library's parts."""
    found: list[Content] = []
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for chunk in StreamReader(file, emit_chunks=True).records:
            if isinstance(chunk, Channel):
                topics[chunk.id] = chunk.topic
            if not isinstance(chunk, Chunk):
                continue
            content: Content = Counter()
            for record in breakup_chunk(chunk, validate_crc=True):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    content[topics[record.channel_id], record.log_time, record.data] += 1
            found.append(content)
    return found


@dataclass(frozen=True, kw_only=True)
class Whole:
    """A whole file of chunks, and what is in it."""

    data: bytes
    spans: list[tuple[int, int]]
    contents: list[Content]  # of each chunk

    @classmethod
    def of(cls, path: Path) -> "Whole":
        """Read a file whose messages are all in chunks."""
        data = path.read_bytes()
        whole = cls(data=data, spans=chunk_spans(data, path), contents=chunk_contents(path))
        assert sum(whole.contents, Counter()) == content_of(path)
        return whole

    def readable(self, bad: bytes) -> Content:
        """Messages that a damaged copy surely still holds where they can be found.

        Those of chunks before the first changed byte, and, if nothing was shifted and the index is
        whole, of every chunk that did not change.
        """
        length = min(len(self.data), len(bad))
        one, two = (np.frombuffer(x, np.uint8, length) for x in (self.data, bad))
        other = np.flatnonzero(one != two) if length else np.zeros(0, int)
        first = int(other[0]) if len(other) else length
        index = self.spans[-1][1]
        placed = len(bad) == len(self.data) and bad[index:] == self.data[index:]
        kept = [
            content
            for (start, end), content in zip(self.spans, self.contents, strict=True)
            if end <= first or (placed and bad[start:end] == self.data[start:end])
        ]
        return sum(kept, Counter())


def silent_loss(path: Path, whole: Whole) -> str:
    """Why what is read of a damaged file is not the truth; "" if it is.

    The truth: the very messages of the whole file, or a loss that is told; with a loss, all that
    surely can be read is read, and where the file knows its number of messages the count is right.
    """
    try:
        source = McapSource(path)
    except DoughError:
        return ""  # refused
    read: Content = Counter()
    for message, data in source.raw_messages(list(source.topics)):
        read[message.topic, message.log_time, data] += 1
    if source.losses:
        left = (whole.readable(path.read_bytes()) - read).total()
        (loss,) = source.losses
        told = source.num_messages + loss.count if loss.unit == "message" else source.num_expected
        if told != source.num_expected or source.num_messages != read.total():
            return f"{loss} is told, {read.total()} of {source.num_expected} were read"
        return f"{left} messages can be read and were not" * bool(left)
    every = sum(whole.contents, Counter())
    missing, strange = (every - read).total(), (read - every).total()
    return f"{missing} messages missing and {strange} strange, none told" * bool(missing + strange)
