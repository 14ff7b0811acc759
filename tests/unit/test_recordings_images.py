"""Pixels of image messages, of every encoding that robots record."""

import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from doughdata.recordings.colour import colour_range
from doughdata.recordings.compressed_depth import decode_compressed_depth
from doughdata.recordings.images import COLOUR, decode_colour, decode_depth
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


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("encoding", sorted(COLOUR))
def test_raw_colour_is_rgb(encoding, padding):
    """Every channel order, with and without row padding, gives the same red, green and blue."""
    channels, order = COLOUR[encoding]
    pixels = np.zeros((6, 5, channels), np.uint8)
    for value, place in enumerate(order):
        pixels[..., place] = RGB[..., value]
    expected = RGB if channels > 1 else np.repeat(pixels, 3, axis=-1)
    assert np.array_equal(decode_colour(raw(pixels, encoding, padding=padding)), expected)


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
