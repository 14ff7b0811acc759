"""What a page's arrays are packed into, read back by another way than the writer's."""

import zlib
from base64 import b64decode

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from doughdata.view.packing import pack, quantise, smallest_unsigned


def unpacked(entries: list[dict], text: str) -> dict[str, np.ndarray]:
    """The arrays, by the description in `packing.py`, one number at a time."""
    raw, offset, found = zlib.decompress(b64decode(text)), 0, {}
    for entry in entries:
        rows, columns, size = entry["rows"], entry["columns"], np.dtype(entry["dtype"]).itemsize
        count = rows * columns
        part = raw[offset : offset + count * size]
        offset += count * size
        values = [sum(part[k + plane * count] << 8 * plane for plane in range(size))
                  for k in range(count)]  # fmt: skip
        table = [[values[column * rows + row] for column in range(columns)] for row in range(rows)]
        if entry["delta"]:
            for row in range(1, rows):
                table[row] = [(a + b) % 256**size for a, b in zip(table[row - 1], table[row])]  # noqa: B905
        whole = np.array(table, f"<u{size}").reshape(rows, columns)
        found[entry["name"]] = whole.view(entry["dtype"])
    assert offset == len(raw)
    return found


SHAPES = arrays.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=7)
ARRAYS = st.one_of(
    *(arrays.arrays(kind, SHAPES) for kind in (np.uint8, np.uint16, np.uint32)),
    arrays.arrays(np.float32, SHAPES, elements=st.floats(width=32)),
)


@settings(deadline=None)
@given(st.lists(ARRAYS, max_size=4), st.booleans())
def test_arrays_come_back_bit_for_bit(given_arrays: list[np.ndarray], plain: bool) -> None:
    """Whatever is packed, differenced or plain, comes back with the same bits and shape."""
    named = {f"a{k}": array for k, array in enumerate(given_arrays)}
    back = unpacked(*pack(named, plain=tuple(named) if plain else ()))
    assert back.keys() == named.keys()
    for name, array in named.items():
        assert (back[name].dtype, back[name].shape) == (array.dtype, array.shape)
        assert back[name].tobytes() == array.tobytes()


@pytest.mark.parametrize("array", [np.zeros(3, np.uint8), np.zeros((2, 2)), np.zeros((1, 1), int)])
def test_other_arrays_are_refused(array: np.ndarray) -> None:
    """Wrong dimensions or a type without a typed array in the browser raise, with the name."""
    with pytest.raises(ValueError, match="mine: a two-dimensional array"):
        pack({"mine": array})


@settings(deadline=None)
@given(arrays.arrays(np.float32, (20, 3), elements=st.floats(-0.25, 0.25, width=32)))
def test_quantised_points_are_off_by_half_a_step(points: np.ndarray) -> None:
    """Stored steps give every coordinate back to within half a step and rounding."""
    low, step = np.array([-0.25, -0.25, -0.25]), 1e-5
    back = low + step * quantise(points, low, step).astype(float)
    assert np.abs(back - points).max() <= step / 2 + 1e-12


def test_points_outside_the_box_are_refused() -> None:
    """A point below the box or beyond 65535 steps raises instead of wrapping round."""
    for x in (-1.0, 0.66, np.nan):
        with pytest.raises(ValueError, match="65535 steps"):
            quantise(np.array([[x, 0.0, 0.0]]), np.zeros(3), 1e-5)


@pytest.mark.parametrize(("most", "size"), [(255, 1), (256, 2), (65535, 2), (65536, 4)])
def test_the_smallest_type_holds_the_values(most: int, size: int) -> None:
    """Values stay what they are in the smallest type that has room for them."""
    values = np.array([[0, most]])
    small = smallest_unsigned(values)
    assert small.dtype.itemsize == size
    assert np.array_equal(small, values)
