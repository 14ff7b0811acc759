"""Random damage to files, and whether what is read of them tells the truth."""

from collections import Counter
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

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


def silent_loss(path: Path, whole: Content) -> str:
    """Why what is read of a damaged file is not the truth; "" if it is.

    The truth: either the very messages of the whole file, or a loss that is told. Messages whose
    bytes were never written must be told as well.
    """
    try:
        source = McapSource(path)
    except DoughError:
        return ""  # refused
    read: Content = Counter()
    for message, data in source.raw_messages(list(source.topics)):
        read[message.topic, message.log_time, data] += 1
    if source.losses:
        return ""
    missing, strange = (whole - read).total(), (read - whole).total()
    return f"{missing} messages missing and {strange} strange, none told" * bool(missing + strange)
