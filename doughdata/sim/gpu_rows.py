"""Rows of flat arrays that hold many clouds: how the host packs them, how kernels read them.

A row of `numbers` and of `counts` holds what a cloud is moved by, a row of `state` how far it is.
Each cloud owns the nodes of its active box alone, whole blocks of them in one array: node (i, j, k)
of its domain is `first + ((i - low_i) size_j + j - low_j) size_k + k - low_k`.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from typing import Any

from doughdata.sim._taichi import ti
from doughdata.sim.contact import Contact, Grid, Int3
from doughdata.sim.stress import Vec3
from doughdata.sim.transfers import Dough

__all__ = [
    "BLOCK",
    "COUNTS",
    "DETAIL",
    "FIRST",
    "HIGH",
    "LIMIT",
    "LOW",
    "NUMBERS",
    "STATE",
    "STATUS",
    "box_of",
    "node_at",
    "opening_now",
    "pack_counts",
    "pack_numbers",
    "row_contact",
    "row_count",
    "row_dough",
    "row_grid",
    "row_number",
    "sdf_sample_from",
]

BLOCK = 128  # nodes; a cloud owns whole blocks

# Columns of `numbers`: `dt`, then the fields of Grid, Dough and Contact that are floats.
NUMBERS = (
    *("dt", "dx", "inverse", "origin_x", "origin_y", "origin_z"),
    *("shear", "bulk", "yield_strain", "volume", "mass", "gravity", "density_cap"),
    *("opening", "rate", "friction", "table_friction", "reach", "band", "sdf_spacing"),
    *("gap_x", "gap_y", "gap_z", "axis_x", "axis_y", "axis_z"),
    *("sdf_origin_x", "sdf_origin_y", "sdf_origin_z"),
)
# Columns of `counts`; `done` is how many substeps the cloud had made before this launch's first.
COUNTS = (
    *("shape_x", "shape_y", "shape_z", "table", "fingers"),
    *("sdf_shape_x", "sdf_shape_y", "sdf_shape_z", "sdf_first", "done"),
)
# Columns of `state`: substeps that the cloud may make, why it stopped, and its active box.
STATE = 10
LIMIT, STATUS, DETAIL, LOW, HIGH, FIRST = 0, 1, 2, 3, 6, 9


def pack_numbers(*, dt: float, grid: Any, dough: Any, contact: Any) -> list[float]:
    """A row of `numbers` from the structs that the kernels of one cloud take."""
    return _pack(NUMBERS, {"dt": dt}, grid, dough, contact)


def pack_counts(*, sdf_first: int, grid: Any, contact: Any) -> list[int]:
    """A row of `counts` of a cloud that has made no substep yet."""
    return _pack(COUNTS, {"sdf_first": sdf_first, "done": 0}, grid, contact)


def _pack(columns: tuple[str, ...], values: dict[str, Any], *structs: Any) -> list[Any]:
    known = dict(values)
    for struct in structs:
        for name, value in struct.items:
            if hasattr(value, "n"):
                known |= {f"{name}_{axis}": value[d] for d, axis in enumerate("xyz")}
            else:
                known[name] = value
    return [known[name] for name in columns]


@ti.func
def row_vector(row, name: ti.template(), numbers: ti.template()):
    """Three columns of a row, from `name_x` on."""
    first = ti.static(NUMBERS.index(name + "_x"))
    return Vec3(numbers[row, first], numbers[row, first + 1], numbers[row, first + 2])


@ti.func
def row_shape(row, name: ti.template(), counts: ti.template()):
    """Three columns of a row, from `name_x` on."""
    first = ti.static(COUNTS.index(name + "_x"))
    return Int3(counts[row, first], counts[row, first + 1], counts[row, first + 2])


@ti.func
def row_number(row, name: ti.template(), numbers: ti.template()):
    """One column of a row."""
    return numbers[row, ti.static(NUMBERS.index(name))]


@ti.func
def row_count(row, name: ti.template(), counts: ti.template()):
    """One column of a row."""
    return counts[row, ti.static(COUNTS.index(name))]


@ti.func
def row_grid(row, numbers: ti.template(), counts: ti.template()):
    """Background grid of a cloud's whole domain."""
    return Grid(
        origin=row_vector(row, "origin", numbers),
        dx=row_number(row, "dx", numbers),
        inverse=row_number(row, "inverse", numbers),
        shape=row_shape(row, "shape", counts),
        table=row_count(row, "table", counts),
    )


@ti.func
def row_dough(row, numbers: ti.template()):
    """Material and particles of a cloud."""
    return Dough(
        shear=row_number(row, "shear", numbers),
        bulk=row_number(row, "bulk", numbers),
        yield_strain=row_number(row, "yield_strain", numbers),
        volume=row_number(row, "volume", numbers),
        mass=row_number(row, "mass", numbers),
        gravity=row_number(row, "gravity", numbers),
        density_cap=row_number(row, "density_cap", numbers),
        driven=0,
        pull=Vec3(0.0),
    )


@ti.func
def row_contact(row, numbers: ti.template(), counts: ti.template()):
    """Fingers and table of a cloud."""
    return Contact(
        fingers=row_count(row, "fingers", counts),
        gap=row_vector(row, "gap", numbers),
        axis=row_vector(row, "axis", numbers),
        opening=row_number(row, "opening", numbers),
        rate=row_number(row, "rate", numbers),
        friction=row_number(row, "friction", numbers),
        table_friction=row_number(row, "table_friction", numbers),
        reach=row_number(row, "reach", numbers),
        band=row_number(row, "band", numbers),
        sdf_origin=row_vector(row, "sdf_origin", numbers),
        sdf_spacing=row_number(row, "sdf_spacing", numbers),
        sdf_shape=row_shape(row, "sdf_shape", counts),
    )


@ti.func
def opening_now(row, n, numbers: ti.template(), counts: ti.template()):
    """Opening [m] at the start of substep `n` of this launch."""
    step = ti.cast(row_count(row, "done", counts) + n, ti.f32)
    speed = row_number(row, "rate", numbers) * row_number(row, "dt", numbers)
    return row_number(row, "opening", numbers) + speed * step


@ti.func
def box_of(row, state: ti.template()):
    """First node of a cloud's active box and the box's size."""
    low = Int3(state[row, LOW], state[row, LOW + 1], state[row, LOW + 2])
    high = Int3(state[row, HIGH], state[row, HIGH + 1], state[row, HIGH + 2])
    return low, high - low


@ti.func
def node_at(at, n, state: ti.template(), owner: ti.template()):
    """Cloud, place in its box, and the box's size, of an entry of the node arrays; -1: unused."""
    row = owner[at // BLOCK]
    _, size = box_of(row, state)
    local = at - state[row, FIRST]
    if state[row, LIMIT] <= n or local < 0 or local >= size[0] * size[1] * size[2]:
        row = -1
    # `ti.max`: a box without nodes must not divide by zero.
    layer, line = ti.max(1, size[1] * size[2]), ti.max(1, size[2])
    return row, Int3(local // layer, local % layer // line, local % line), size


@ti.func
def sdf_sample_from(first, local, sdf: ti.template(), contact: ti.template()):
    """`contact.sdf_sample` of the distance grid that begins at entry `first` of a shared array."""
    u = (local - contact.sdf_origin) / contact.sdf_spacing
    low = Int3(0, 0, 0)
    for d in ti.static(range(3)):
        low[d] = ti.max(0, ti.min(ti.cast(u[d], ti.i32), contact.sdf_shape[d] - 2))
    f = u - ti.cast(low, ti.f32)
    distance, gradient = 0.0, Vec3(0.0)
    for o in range(8):
        a, b, c = o // 4, o // 2 % 2, o % 2
        at = ((low[0] + a) * contact.sdf_shape[1] + low[1] + b) * contact.sdf_shape[2] + low[2] + c
        value = sdf[first + at]
        wx = ti.select(a == 1, f[0], 1.0 - f[0])
        wy = ti.select(b == 1, f[1], 1.0 - f[1])
        wz = ti.select(c == 1, f[2], 1.0 - f[2])
        sx, sy, sz = 2.0 * a - 1.0, 2.0 * b - 1.0, 2.0 * c - 1.0
        distance = distance + value * wx * wy * wz
        gradient = gradient + value * Vec3(sx * wy * wz, wx * sy * wz, wx * wy * sz)
    length = ti.sqrt(gradient.dot(gradient))
    return distance, gradient / ti.max(length, 1e-9)
