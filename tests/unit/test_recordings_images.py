"""Pixels of image messages, of every encoding that robots record."""

import struct
from dataclasses import replace
from zlib import crc32

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from doughdata.recordings.colour import colour_range
from doughdata.recordings.compressed_depth import decode_compressed_depth
from doughdata.recordings.images import decode_colour, decode_depth, holds_depth
from doughdata.recordings.pictures import Picture, PictureError
from doughdata.recordings.rvl import decode_rvl, encode_rvl
from doughschemas import BadInputError

RGB = np.random.default_rng(1).integers(0, 256, (6, 5, 3), dtype=np.uint8)
UNITS = np.random.default_rng(2).integers(0, 65536, (6, 5)).astype(np.uint16)


def raw(pixels, encoding, *, padding=0, big=False):
    """A raw image message as a camera's driver lays it out."""
    pixels = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    return Picture(
        stamp=1,
        frame="camera",
        format=encoding,
        data=rows.tobytes(),
        compressed=False,
        width=pixels.shape[1],
        height=pixels.shape[0],
        step=rows.shape[1],
        big_endian=big,
    )


def packed(data, form):
    """A compressed image message."""
    return Picture(stamp=1, frame="camera", format=form, data=data, compressed=True)


PLAIN = [  # encoding, stored channels in the order of the name
    *((f"{name}{bits}", name) for name in ("rgb", "bgr", "rgba", "bgra") for bits in (8, 16)),
    ("8uc3", "bgr"),
    ("8uc4", "bgra"),
]


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize(("encoding", "order"), PLAIN)
def test_raw_colour_is_rgb(encoding, order, padding):
    """Every channel order, with and without row padding, gives the same red, green and blue."""
    planes = {"r": RGB[..., 0], "g": RGB[..., 1], "b": RGB[..., 2], "a": np.full((6, 5), 255)}
    pixels = np.stack([planes[letter] for letter in order], axis=-1)
    if encoding.endswith("16"):
        pixels = pixels.astype(np.uint16) * 256 + 77
    pixels = pixels.astype(np.uint16 if encoding.endswith("16") else np.uint8)
    assert np.array_equal(decode_colour(raw(pixels, encoding, padding=padding)), RGB)


@pytest.mark.parametrize(("encoding", "shift"), [("mono8", 0), ("8uc1", 0), ("mono16", 8)])
def test_grey_is_grey(encoding, shift):
    """One channel becomes three equal ones; of 16 bits the upper eight count."""
    grey = RGB[..., 0].astype(np.uint16 if shift else np.uint8) << shift
    assert np.array_equal(decode_colour(raw(grey, encoding)), np.stack([RGB[..., 0]] * 3, axis=-1))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("tile", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_of_one_colour(tile, bits):
    """A mosaic of one colour, laid out as its name says, gives that colour in every pixel."""
    color = {"r": 200, "g": 120, "b": 40}
    cells = np.array([color[letter] for letter in tile]).reshape(2, 2) << (bits - 8)
    pixels = np.tile(cells, (4, 4)).astype(np.uint16 if bits == 16 else np.uint8)
    got = decode_colour(raw(pixels, f"bayer_{tile}{bits}"))
    assert np.all(got == list(color.values()))


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("yuv422", "UYVY"), ("uyvy", "UYVY"), ("yuv422_yuy2", "YUYV"), ("yuyv", "YUYV")],
)
def test_yuv_is_the_standards_rgb(encoding, order):
    """YUV 4:2:2 gives the colours of BT.601 (16-235), two pixels sharing their U and V."""
    values = {"U": 90, "V": 180}
    luma = [60, 200]
    row = [luma[k // 2] if letter == "Y" else values[letter] for k, letter in enumerate(order)]
    pixels = np.tile(np.array(row, np.uint8).reshape(2, 2), (3, 2, 1))
    expected = []
    for y in luma:
        y, u, v = 1.164 * (y - 16), values["U"] - 128, values["V"] - 128
        expected.append([y + 1.596 * v, y - 0.392 * u - 0.813 * v, y + 2.017 * u])
    got = decode_colour(raw(pixels, encoding))
    assert np.abs(got.astype(float) - np.tile(np.clip(expected, 0, 255), (3, 2, 1))).max() < 2
    with pytest.raises(PictureError, match="in pairs"):
        decode_colour(raw(pixels[:, :3], encoding))


def test_a_plain_png_of_depth():
    """What image_transport's plain compression makes of 16-bit depth is depth; a JPEG is not."""
    data = cv2.imencode(".png", UNITS)[1].tobytes()
    assert holds_depth(packed(data, "16uc1; png compressed "))
    assert np.array_equal(decode_depth(packed(data, "16uc1; png compressed ")), UNITS)
    for other in (cv2.imencode(".jpeg", RGB)[1], cv2.imencode(".png", RGB)[1]):
        with pytest.raises(PictureError, match="depth"):
            decode_depth(packed(other.tobytes(), "16uc1; png compressed "))


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_a_picture_that_claims_to_be_huge_is_refused(kind):
    """A size of 65,000 x 65,000 in the header is one clear error."""
    data = bytearray(cv2.imencode(f".{kind}", RGB)[1].tobytes())
    if kind == "png":
        struct.pack_into(">II", data, 16, 65000, 65000)
        struct.pack_into(">I", data, 29, crc32(data[12:29]))
    else:
        struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, 65000, 65000)
    with pytest.raises(PictureError):
        decode_colour(packed(bytes(data), kind))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 2, 7])
def test_raw_depth_is_exact(big, padding):
    """16-bit and float depth come bit for bit, whatever byte order and row padding."""
    assert np.array_equal(decode_depth(raw(UNITS, "16uc1", padding=padding, big=big)), UNITS)
    metres = (UNITS / 1000).astype(np.float32)
    assert np.array_equal(decode_depth(raw(metres, "32fc1", padding=padding, big=big)), metres)


def test_png_depth_is_exact():
    """compressedDepth PNG brings every value back; a format without a codec means PNG."""
    data = struct.pack("<iff", 0, 0, 0) + cv2.imencode(".png", UNITS)[1].tobytes()
    for form in ("16UC1; compressedDepth png", "16UC1; compressedDepth", "compressedDepth"):
        assert np.array_equal(decode_compressed_depth(data, form), UNITS)


def test_inverse_depth_is_within_its_quantisation():
    """Float compressedDepth is A / (q - B): the error is at most half a step of q."""
    depth = np.linspace(0.3, 2.0, 30, dtype=np.float32).reshape(6, 5)
    a, b = 100.0 * (100 + 1), 100.0
    q = np.rint(a / depth + b).astype(np.uint16)
    q[0, 0] = 0
    data = struct.pack("<iff", 0, a, b) + cv2.imencode(".png", q)[1].tobytes()
    got = decode_compressed_depth(data, "32FC1; compressedDepth png")
    assert np.isnan(got[0, 0])
    assert np.all(np.abs(got - depth).flat[1:] <= (0.51 * depth**2 / a).flat[1:])


@given(hnp.arrays(np.uint16, st.integers(1, 200), elements=st.sampled_from([0, 1, 5, 900, 65535])))
def test_rvl_round_trip(pixels):
    """What RVL encodes it decodes, runs of zeros at any place included."""
    assert np.array_equal(decode_rvl(encode_rvl(pixels), len(pixels)), pixels)


def test_rvl_of_the_paper():
    """A stream worked out by hand from the paper's definition decodes to its pixels.

    Pixels 0, 0, 10, 12: two zeros (2), two non-zeros (2), differences 10 and 2, zigzag 20 and 4;
    20 needs two groups, 4 | 8 then 2. Groups 2 2 C 2 4, high bits first in a little-endian word.
    """
    data = (0x22C24000).to_bytes(4, "little")
    assert decode_rvl(data, 4).tolist() == [0, 0, 10, 12]


@given(st.binary(max_size=80), st.integers(1, 60))
def test_any_bytes_as_rvl_are_decoded_or_refused(data, count):
    """Random bytes give that many pixels or one clear error, never anything else."""
    try:
        pixels = decode_rvl(data, count)
    except PictureError:
        return
    assert pixels.shape == (count,)


@given(st.binary(max_size=60), st.sampled_from(["16UC1; compressedDepth png", "compressedDepth"]))
def test_any_bytes_as_compressed_depth_are_refused(data, form):
    """Random bytes are no image, and the error is one line."""
    with pytest.raises(PictureError) as error:
        decode_compressed_depth(data, form)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_compressed_colour(kind):
    """PNG comes exactly, JPEG nearly; a format that says "compressed rgb8" is swapped back."""
    smooth = cv2.resize(RGB, (64, 48), interpolation=cv2.INTER_CUBIC)
    data = cv2.imencode(f".{kind}", smooth[..., ::-1])[1].tobytes()
    got = decode_colour(packed(data, f"rgb8; {kind} compressed bgr8")).astype(int)
    assert np.abs(got - smooth).mean() <= (0 if kind == "png" else 10)
    swapped = decode_colour(packed(data, f"rgb8; {kind} compressed rgb8"))
    assert np.array_equal(swapped, got[..., ::-1])


@pytest.mark.parametrize("kind", ["png", "jpeg"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_a_cut_picture_is_refused(kind, share):
    """A compressed picture whose end is missing is refused, not filled with grey."""
    pixels = np.random.default_rng(3).integers(0, 256, (80, 60, 3), dtype=np.uint8)
    data = cv2.imencode(f".{kind}", pixels)[1].tobytes()
    with pytest.raises(PictureError, match="cut or damaged"):
        decode_colour(packed(data[: int(len(data) * share)], f"bgr8; {kind} compressed bgr8"))


def test_one_changed_byte_in_a_png_is_refused():
    """Depth in a PNG whose checksum does not fit is refused, not decoded to something else."""
    data = bytearray(cv2.imencode(".png", UNITS)[1].tobytes())
    data[len(data) // 2] ^= 8
    with pytest.raises(PictureError):
        decode_compressed_depth(struct.pack("<iff", 0, 0, 0) + bytes(data), "compressedDepth")


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"height": 0},
        {"height": 7},
        {"width": 6},
        {"step": 3},
        {"height": 1 << 30, "width": 1 << 30},
        {"data": b""},
        {"format": "rggb8"},
    ],
)
def test_sizes_that_disagree_are_refused(change):
    """Zero sizes, a step below a row, and data of another length are refused in one line."""
    picture = replace(raw(UNITS, "16uc1"), **change)
    with pytest.raises(PictureError) as error:
        decode_depth(picture)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "inside", "outside"),
    [
        ("340-20", (255, 0, 0), (0, 255, 0)),
        ("340-20", (255, 0, 60), (255, 120, 0)),
        ("90-150", (0, 255, 0), (255, 0, 0)),
        ("0-360,0-100,50-100", (200, 200, 200), (20, 20, 20)),
    ],
)
def test_hue_wraps_around(text, inside, outside):
    """A hue range whose end is below its beginning goes over 360 degrees."""
    pixels = np.array([[inside, outside]], np.uint8)
    assert colour_range(text).holds(pixels).tolist() == [[True, False]]


@pytest.mark.parametrize("text", ["", "red", "10", "10-400", "0-10,50-20", "1-2,3-4,5-6,7-8"])
def test_what_is_no_colour_is_refused(text):
    """A colour that cannot be meant is refused with the form that is expected."""
    with pytest.raises(BadInputError):
        colour_range(text)
