"""Each damage of a real recording: what the command says, its exit code, and what is left behind.

The recordings are made of the real one beside the tests; where the project's collection of samples
lies beside the checkout, those go through the same table.
"""

import json
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from doughcli.app import main
from doughdata.dataset import open_dataset
from doughdata.geometry import pixel_rays, quaternion_to_matrix
from doughschemas import SEGMENT_COMPONENT
from tests.recordings_samples import COLLECTION, MAKE, MUG
from tests.unit.test_recordings_real import ransac

LENS = {"width": 640, "height": 480, "fx": 616.37, "fy": 616.2, "cx": 310.3, "cy": 236.6}
MESSAGES = 28  # of a whole sample


@dataclass(frozen=True, kw_only=True)
class Told:
    """What must come of a sample."""

    code: int
    frames: tuple[int, ...] = ()  # how many there may be; none: no dataset
    line: str = ""  # in what is printed on stderr
    lost: tuple[str, ...] = ()  # units of the losses that the dataset records


WHOLE = Told(code=0, frames=(3,))
TABLE = [
    ("00_ok_base.mcap", (), WHOLE),
    ("06_no_summary_no_index.mcap", (), WHOLE),
    ("01_truncated_60pct.mcap", (), Told(code=1, line="cut short")),
    ("08_chunk_crc_mismatch.mcap", (), Told(code=1, line="CRC")),
    ("09_unknown_compression.mcap", (), Told(code=1, line="'zst9'")),
    ("01_truncated_60pct.mcap", ("--salvage",), Told(code=0, frames=(1,), lost=("damaged place",))),
    ("08_chunk_crc_mismatch.mcap", ("--salvage",), Told(code=0, frames=(1, 2), lost=("message",))),
    ("09_unknown_compression.mcap", ("--salvage",), Told(code=0, frames=(1, 2), lost=("message",))),
    ("20_no_camera_info.mcap", (), Told(code=1, line="--intrinsics")),
    ("20_no_camera_info.mcap", ("--intrinsics", "lens.json"), WHOLE),
    ("22_no_depth.mcap", (), Told(code=1, line="no topic with depth")),
    ("25_depth_half_size_of_colour.mcap", (), Told(code=1, line="320 x 240")),
    ("26_zero_depth.mcap", (), Told(code=1, line="no valid depth")),
    (
        "33_one_depth_png_cut.mcap",
        (),
        Told(code=1, frames=(2,), line="1 image lost", lost=("image",)),
    ),
    ("33_one_depth_png_cut.mcap", ("--salvage",), Told(code=0, frames=(2,), lost=("image",))),
    ("39_whole_file.mcap.zstd", (), Told(code=1, line="zstd -d")),
]
OBJECTS = {  # scene -> frames
    "rs_green_bowl_raw16_zstd.mcap": 2,
    "rs_red_mug_jpeg_cdpng_lz4.mcap": 3,
    "rs_sugar_foxglove_protobuf.mcap": 2,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with the like of every sample."""
    folder = tmp_path_factory.mktemp("samples")
    for name, make in MAKE.items():
        make(folder / name)
    return folder


def run(path, folder, capfd, monkeypatch, *options):
    """Type `doughdata convert` in a folder; exit code and lines on stderr."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(
        sys, "argv", ["doughdata", "convert", str(path), "--dataset", "d", *options]
    )
    with pytest.raises(SystemExit) as done:
        main()
    lines = capfd.readouterr().err.splitlines()
    return done.value.code or 0, [line for line in lines if line.strip()]


def readable(path):
    """Messages in the whole chunks of a file, by the standard library's parts."""
    count = 0
    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=None)
        try:
            for record in reader.records:
                if hasattr(record, "uncompressed_crc"):
                    count += _messages_of(record)
        except Exception:  # where the file is cut
            return count
    return count


def _messages_of(chunk):
    if chunk.compression not in ("", "lz4", "zstd"):  # the library takes others as plain
        return 0
    try:
        data, size = get_chunk_data_stream(chunk, validate_crc=True)
    except Exception:
        return 0
    found = 0
    while data.count < size:
        opcode, length = data.read1(), data.read8()
        data.read(length)
        found += opcode == 5
    return found


@pytest.mark.parametrize("origin", ["made", *["collection"] * COLLECTION.is_dir()])
@pytest.mark.parametrize(("name", "options", "told"), TABLE, ids=lambda v: str(v)[:20])
def test_a_damaged_recording(made, tmp_path, capfd, monkeypatch, origin, name, options, told):
    """Exit code, one line that says why, and either no dataset or one with frames and losses.

    Messages that a salvage reads are those that the standard library finds in whole chunks.
    """
    path = made / name if origin == "made" else COLLECTION / "damaged" / name
    (tmp_path / "lens.json").write_text(json.dumps(LENS))
    code, lines = run(path, tmp_path, capfd, monkeypatch, *options)
    assert code == told.code, lines
    assert len(lines) == (told.code > 0) or bool(told.frames), lines
    assert told.line in " ".join(lines)
    if not told.frames:
        assert not (tmp_path / "d").exists()
        return
    opened = open_dataset(tmp_path / "d")
    parameters = json.loads(opened.scenes["parameters"][0].as_py())
    assert opened.frames.num_rows in told.frames
    assert tuple(loss["unit"] for loss in parameters["losses"]) == told.lost
    assert parameters["figures"]["messages_read"] == readable(path)
    for loss in parameters["losses"]:
        if loss["unit"] == "message":
            assert loss["count"] == MESSAGES - readable(path)


def test_objects_are_found(tmp_path, capfd, monkeypatch):
    """In each scene one object is found; the table is where a RANSAC done apart finds it."""
    found = [path for name in OBJECTS if (path := COLLECTION / name).exists()] or [MUG]
    for path in found:
        folder = tmp_path / path.stem
        folder.mkdir()
        assert run(path, folder, capfd, monkeypatch, "--expect", "ball")[0] == 0
        views = open_dataset(folder / "d").read_depth(0, "recorded")
        assert len(views.depth) == OBJECTS.get(path.name, 3)
        sizes = np.bincount(views.segments[0].reshape(-1))[SEGMENT_COMPONENT:]
        assert len(sizes) == 1
        assert 1_000 < sizes[0] < 100_000
        camera = views.cameras[0]
        cloud = pixel_rays(camera.intrinsics) * (views.depth[0] * views.depth_unit)[..., None]
        normal, distance = ransac(cloud[views.depth[0] > 0][::17], seed=1)
        assert abs(camera.position[2] - distance) < 0.002
        up = quaternion_to_matrix(np.array(camera.quaternion))[2]  # world z in the camera's frame
        assert np.degrees(np.arccos(up @ normal)) < 0.5
