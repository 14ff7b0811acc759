"""Reading MCAP files: what is damaged is told, never skipped in silence."""

import struct
import tracemalloc

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.mcap_source import McapSource
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.topics import choose_topics
from tests.recordings_damage import Whole, chunk_spans, content_of, corrupted, silent_loss
from tests.recordings_made import Recording, rolls_picture, write_mcap
from tests.recordings_samples import real_recordings

COMPRESSIONS = list(CompressionType)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A recording of many small chunks."""
    return write_mcap(tmp_path_factory.mktemp("whole") / "whole.mcap", Recording(gripper=True))


def read(path):
    """(topic, time) of all messages that can be read and decoded."""
    source = McapSource(path)
    return [(m.topic, m.log_time) for m in source.messages(source.topics) if not m.error]


def write_json(path, *, promised):
    """A file with three JSON messages whose statistics promise another number."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for time in range(3):
            writer.add_message(channel, time, b"{}", time)
        # No writer does this on purpose, and none offers it.
        writer._Writer__statistics.message_count = promised
        writer.finish()
    return path


def changed(path, folder, change):
    """A copy of a file with other bytes."""
    out = folder / "changed.mcap"
    out.write_bytes(bytes(change(bytearray(path.read_bytes()))))
    return out


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"enable_data_crcs": True}])
def test_every_message_comes_in_order(tmp_path, compression, options):
    """All messages come, by time, from every compression, chunked or not; nothing is reported."""
    path = write_mcap(tmp_path / "a.mcap", compression=compression, **options)
    source = McapSource(path)
    times = [m.log_time for m in source.messages(source.topics)]
    assert len(times) == content_of(path).total() == source.num_messages == source.num_expected
    assert times == sorted(times)
    assert source.losses == ()


def test_without_summary_and_index_all_is_read(tmp_path):
    """A file without summary and index loses nothing and is no damage."""
    bare = write_mcap(
        tmp_path / "a.mcap",
        use_statistics=False,
        use_summary_offsets=False,
        repeat_channels=False,
        repeat_schemas=False,
        index_types=IndexType.NONE,
    )
    source = McapSource(bare)
    assert source.num_expected is None
    assert len(read(bare)) == 9
    assert source.losses == ()


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_told(whole, tmp_path, share):
    """Wherever a recording is cut, it is refused as no recording or its loss is told."""
    cut = changed(whole, tmp_path, lambda data: data[: int(len(data) * share)])
    if share == 0.0:
        with pytest.raises(RecordingError, match="no MCAP file"):
            McapSource(cut)
        return
    source = McapSource(cut)
    assert "cut short" in source.losses[0].reason
    assert source.num_messages <= content_of(whole).total()


def test_a_bad_chunk_costs_only_itself(whole, tmp_path):
    """A chunk with one changed byte is left out, all others are read, and the count is told."""
    data = whole.read_bytes()
    start, end = chunk_spans(data, whole)[1]

    def flip(data):
        data[(start + end) // 2] ^= 0x55
        return data

    bad = changed(whole, tmp_path, flip)
    source = McapSource(bad)
    (loss,) = source.losses
    assert loss.count == source.num_expected - source.num_messages > 0
    assert set(read(bad)) < set(read(whole))


def test_an_impossible_length_stops_nothing(whole, tmp_path):
    """A record that claims a TiB is told, needs no memory, and the chunks behind it are read."""
    start, _ = chunk_spans(whole.read_bytes(), whole)[0]

    def claim(data):
        struct.pack_into("<Q", data, start + 1, 1 << 40)
        return data

    bad = changed(whole, tmp_path, claim)
    tracemalloc.start()
    source = McapSource(bad)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6
    assert "wrong length" in source.losses[0].reason
    assert 0 < source.num_messages < content_of(whole).total()


@pytest.mark.parametrize("size", [1 << 62, 1 << 31, 5])
def test_a_chunk_that_lies_about_its_size_is_told(whole, tmp_path, size):
    """The unpacked size that a chunk claims is not believed."""
    start, _ = chunk_spans(whole.read_bytes(), whole)[0]

    def claim(data):
        struct.pack_into("<Q", data, start + 9 + 16, size)
        return data

    assert McapSource(changed(whole, tmp_path, claim)).losses


def test_a_summary_that_cannot_be_trusted_costs_no_message(whole, tmp_path):
    """With a damaged summary all messages are read, with a warning and without a loss."""

    def flip(data):
        data[-60] ^= 1
        return data

    source = McapSource(changed(whole, tmp_path, flip))
    assert source.num_messages == content_of(whole).total()
    assert source.losses == ()
    assert "index is damaged" in source.warnings[0]


def test_chunks_in_another_order_give_the_same_messages(whole, tmp_path):
    """Messages come by time, whatever the order of the chunks in the file."""
    (a, b), *_, (c, d) = chunk_spans(whole.read_bytes(), whole)
    swapped = changed(whole, tmp_path, lambda x: x[:a] + x[c:d] + x[b:c] + x[a:b] + x[d:])
    times = [time for _, time in read(swapped)]
    assert times == sorted(times)
    assert sorted(read(swapped)) == sorted(read(whole))


def test_statistics_that_promise_more_are_believed(tmp_path):
    """A file that says it has more messages than can be found is damaged."""
    path = write_json(tmp_path / "a.mcap", promised=5)
    (loss,) = McapSource(path).losses
    assert loss.count == 2


def test_an_encoding_that_nobody_decodes_is_refused_by_name(tmp_path):
    """JSON messages are refused, naming topic and encoding."""
    source = McapSource(write_json(tmp_path / "a.mcap", promised=3))
    with pytest.raises(RecordingError, match=r"/a .*'json'"):
        list(source.messages(["/a"]))


@pytest.mark.parametrize(
    ("schema", "encoding", "text", "reason"),
    [
        ("sensor_msgs/msg/Image", "ros2idl", b"module x {};", "'ros2idl'"),
        ("sensor_msgs/msg/Image", "ros2msg", b"\xff\xfe", "damaged definition"),
        ("sensor_msgs/msg/Image", "ros2msg", b"uint64[900000000] a", "too short"),
        ("foxglove.RawImage", "flatbuffer", b"", "'flatbuffer'"),
        (None, "", b"", "/a [(]no schema[)]"),
    ],
)
def test_images_that_nobody_decodes_are_named(tmp_path, schema, encoding, text, reason):
    """Where no depth can be read the refusal says why the images there are none."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema, encoding, text) if schema else 0
        kind = encoding if encoding == "flatbuffer" else "cdr"
        writer.add_message(writer.register_channel("/a", kind, number), 1, b"\0\1\0\0abcd", 1)
        writer.finish()
    with pytest.raises(RecordingError, match=reason):
        choose_topics(McapSource(path), TopicOptions())


@pytest.mark.parametrize("second", ["itself", "another", "its rest", "rubbish"])
def test_what_follows_the_end_is_told(whole, tmp_path, second):
    """Two recordings in one file are not read as one: what follows the end is told as damage."""
    more = write_mcap(tmp_path / "a.mcap", Recording(pictures=[rolls_picture()])).read_bytes()
    data = whole.read_bytes()
    tail = {"itself": data, "another": more, "its rest": more[8:], "rubbish": b"x" * 90}[second]
    source = McapSource(changed(whole, tmp_path, lambda data: data + tail))
    assert source.num_messages == content_of(whole).total()
    assert "more bytes follow" in source.losses[0].reason


@pytest.mark.parametrize(
    "options", [{"enable_crcs": False}, {"use_chunking": False}, {"enable_data_crcs": True}]
)
def test_messages_without_a_checksum_are_told(tmp_path, options):
    """A warning counts the messages whose damage nothing would show."""
    path = write_mcap(tmp_path / "a.mcap", **options)
    told = [line for line in McapSource(path).warnings if "no checksum" in line]
    covered = "enable_data_crcs" in options
    assert [int(line.split()[0]) for line in told] == [content_of(path).total()] * (not covered)


def test_a_cut_after_any_record_is_told(whole, tmp_path):
    """Cut at each boundary of records and within each header: told, with every whole chunk read."""
    known, place = Whole.of(whole), 8
    while place < len(known.data) - 8:
        for more in (0, 1, 9):
            cut = changed(whole, tmp_path, lambda data, end=place + more: data[:end])
            assert McapSource(cut).losses
            assert not silent_loss(cut, known)
        place += 9 + struct.unpack_from("<Q", known.data, place + 1)[0]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_no_damage_is_silent(tmp_path, compression):
    """Of 120 random damages, each leaves all messages readable or is told."""
    pictures = [rolls_picture()] * 2
    path = write_mcap(
        tmp_path / "a.mcap",
        Recording(pictures=pictures, color="jpeg", depth="png"),
        chunk_size=4000,
        compression=compression,
    )
    check_damage(path, tmp_path / "b.mcap", count=60)


@pytest.mark.slow
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_no_damage_is_silent_2000(tmp_path, compression):
    """The same with 2,000 damages of each compression."""
    path = write_mcap(tmp_path / "a.mcap", compression=compression, chunk_size=20_000)
    check_damage(path, tmp_path / "b.mcap", count=2000)


@pytest.mark.slow
def test_no_damage_of_real_recordings_is_silent_2000(tmp_path):
    """The same with 2,000 damages, dealt out to all real recordings that are at hand."""
    samples = real_recordings()
    for number, path in enumerate(samples):
        check_damage(path, tmp_path / "b.mcap", count=2000 // len(samples), first=10_000 * number)


def check_damage(path, bad, *, count, first=0):
    """Damage a file again and again; each result must be told or whole."""
    whole = Whole.of(path)
    for seed in range(first, first + count):
        bad.write_bytes(corrupted(whole.data, whole.spans, np.random.default_rng(seed)))
        assert not silent_loss(bad, whole), seed
