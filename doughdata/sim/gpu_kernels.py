"""MLS-MPM substeps of many clouds at once, for a GPU: parallel loops, atomic sums.

The same method as `kernels.py`, arranged for thousands of threads: one thread a particle or node,
all clouds in flat arrays, momentum scattered with atomics. The order of sums is not fixed, so two
runs agree to rounding, not to the bit; the CPU's are bitwise.

What belongs to a cloud is a row of arrays (`gpu_rows.py`). Active boxes and their nodes are found
on the device, so that the host waits for nothing within a stretch of time. A cloud that does not
fit into the node arrays waits, unchanged, until the host has made room.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.arrays import (
    Counts,
    Integers,
    Matrices,
    Nodes,
    Numbers,
    Scalars,
    Symmetrics,
    Vectors,
)
from doughdata.sim.contact import (
    FAR,
    Int3,
    Vec4,
    finger_local,
    finger_world,
    sdf_holds,
)
from doughdata.sim.gpu_rows import (
    BLOCK,
    DETAIL,
    FIRST,
    HIGH,
    LIMIT,
    LOW,
    STATUS,
    box_of,
    node_at,
    opening_now,
    row_contact,
    row_count,
    row_grid,
    sdf_sample_from,
)
from doughdata.sim.gpu_transfers import gather, move_node, scatter
from doughdata.sim.kernels import MARGIN
from doughdata.sim.stress import Vec3
from doughdata.sim.transfers import LEFT_DOMAIN

__all__ = ["look", "substep"]


BIG = 1 << 30


@ti.kernel
def look(
    n: ti.i32,
    x: Vectors,
    cloud: Integers,
    numbers: Numbers,
    counts: Counts,
    state: Counts,
    used: Integers,
    owner: Integers,
    colliders: Nodes,
    free: Scalars,
    room: Scalars,
    touch: Integers,
    sdf: Scalars,
):
    """Find the active boxes, give them nodes, and find fingers and touched walls at these.

    `used` is (blocks in use now, most blocks asked for); a cloud that gets none has its `LIMIT` set
    to `n`, and so has one with a particle too near the border of its domain (or nowhere).
    """
    for row in range(state.shape[0]):
        for d in ti.static(range(3)):
            state[row, LOW + d] = BIG
            state[row, HIGH + d] = -BIG
        if row == 0:
            used[0] = 0
    for i in range(x.shape[0]):
        row = cloud[i]
        if state[row, LIMIT] > n:
            grid = row_grid(row, numbers, counts)
            place = (x[i] - grid.origin) * grid.inverse - 0.5
            for d in ti.static(range(3)):
                # Compared as floats: not a number is outside, and has no integer.
                last = ti.cast(grid.shape[d] - 3 - MARGIN, ti.f32)
                if place[d] >= ti.cast(MARGIN, ti.f32) and place[d] < last + 1.0:
                    base = ti.cast(place[d], ti.i32)
                    # Most particles lie within the box so far: looking is cheaper than an atomic.
                    if base - MARGIN < state[row, LOW + d]:
                        ti.atomic_min(state[row, LOW + d], base - MARGIN)
                    if base + 3 + MARGIN > state[row, HIGH + d]:
                        ti.atomic_max(state[row, HIGH + d], base + 3 + MARGIN)
                else:
                    state[row, STATUS] = LEFT_DOMAIN
                    ti.atomic_min(state[row, DETAIL], d)
    for row in range(state.shape[0]):
        if state[row, STATUS] != 0:
            ti.atomic_min(state[row, LIMIT], n)
        if state[row, LIMIT] > n:
            _, size = box_of(row, state)
            blocks = (size[0] * size[1] * size[2] + BLOCK - 1) // BLOCK
            first = ti.atomic_add(used[0], blocks)
            ti.atomic_max(used[1], first + blocks)
            state[row, FIRST] = first * BLOCK
            if first + blocks > owner.shape[0]:
                state[row, LIMIT] = n
            else:
                for block in range(first, first + blocks):
                    owner[block] = row
    for at in range(BLOCK * ti.min(used[0], owner.shape[0])):
        row, place, _ = node_at(at, n, state, owner)
        touch[at] = 0
        if row >= 0 and row_count(row, "fingers", counts) > 0:
            grid, contact = row_grid(row, numbers, counts), row_contact(row, numbers, counts)
            low, _ = box_of(row, state)
            node = grid.origin + grid.dx * ti.cast(low + place, ti.f32)
            opening = opening_now(row, n, numbers, counts)
            first = row_count(row, "sdf_first", counts)
            occupied = 0.0
            for finger in range(2):
                local = finger_local(node, finger, opening, contact)
                found = Vec4(0.0, 0.0, 0.0, FAR)
                if sdf_holds(local, 0.5 * grid.dx, contact):
                    distance, gradient = sdf_sample_from(first, local, sdf, contact)
                    w = finger_world(gradient, finger, contact)
                    found = Vec4(w[0], w[1], w[2], distance)
                    if distance < grid.dx:  # eight samples of the cell, each half a cell wide
                        for o in range(8):
                            corner = Vec3(o // 4, o // 2 % 2, o % 2) - 0.5
                            around = local + (0.5 * grid.dx) * corner
                            d, _ = sdf_sample_from(first, around, sdf, contact)
                            filled = ti.max(0.0, ti.min(1.0, 0.5 - 2.0 * d / grid.dx))
                            occupied = occupied + 0.125 * filled
                colliders[finger * free.shape[0] + at] = found
            free[at] = ti.max(0.0, 1.0 - occupied)
    # B-spline taps along the three axes at once; a node at the box's border keeps its own there.
    for at in range(BLOCK * ti.min(used[0], owner.shape[0])):
        row, place, size = node_at(at, n, state, owner)
        if row >= 0 and row_count(row, "fingers", counts) > 0:
            total = 0.0
            for o in range(27):
                offset = Int3(o // 9 - 1, o // 3 % 3 - 1, o % 3 - 1)
                w = 1.0
                for d in ti.static(range(3)):
                    border = place[d] == 0 or place[d] == size[d] - 1
                    side = ti.select(border, 0.0, 0.125)
                    w = w * ti.select(offset[d] == 0, 1.0 - 2.0 * side, side)
                if w > 0.0:
                    shift = (offset[0] * size[1] + offset[1]) * size[2] + offset[2]
                    total = total + w * free[at + shift]
            room[at] = total
    for i in range(x.shape[0]):
        row = cloud[i]
        if state[row, LIMIT] > n:
            mark_touched(x[i], row, n, numbers, counts, state, touch, sdf)


@ti.kernel
def restore(
    again: Integers,
    cloud: Integers,
    x: Vectors,
    v: Vectors,
    C: Matrices,
    b: Symmetrics,
    largest: Scalars,
    x_before: Vectors,
    v_before: Vectors,
    C_before: Matrices,
    b_before: Symmetrics,
    largest_before: Scalars,
):
    """Take the clouds with `again[row]` back to what they were."""
    for i in range(x.shape[0]):
        if again[cloud[i]] != 0:
            x[i], v[i], C[i], b[i] = x_before[i], v_before[i], C_before[i], b_before[i]
            largest[i] = largest_before[i]


@ti.func
def mark_touched(
    place,
    row,
    n,
    numbers: ti.template(),
    counts: ti.template(),
    state: ti.template(),
    touch: ti.template(),
    sdf: ti.template(),
):
    """`contact.find_touch` of one particle: which walls it touches, told to its 27 nodes."""
    grid, contact = row_grid(row, numbers, counts), row_contact(row, numbers, counts)
    walls = ti.select(grid.table >= 0 and place[2] <= contact.reach, 4, 0)
    opening = opening_now(row, n, numbers, counts)
    for finger in range(contact.fingers):
        local = finger_local(place, finger, opening, contact)
        if sdf_holds(local, 0.0, contact):
            first = row_count(row, "sdf_first", counts)
            distance, _ = sdf_sample_from(first, local, sdf, contact)
            if distance <= contact.reach:
                walls = walls | (1 << finger)
    if walls > 0:
        low, size = box_of(row, state)
        rel = ti.cast((place - grid.origin) * grid.inverse - 0.5, ti.i32) - low
        corner = state[row, FIRST] + (rel[0] * size[1] + rel[1]) * size[2] + rel[2]
        for p, q, r in ti.static(ti.ndrange(3, 3, 3)):
            ti.atomic_or(touch[corner + (p * size[1] + q) * size[2] + r], walls)


@ti.kernel
def substep(
    n: ti.i32,
    x: Vectors,
    v: Vectors,
    C: Matrices,
    b: Symmetrics,
    largest: Scalars,
    cloud: Integers,
    numbers: Numbers,
    counts: Counts,
    state: Counts,
    used: Integers,
    owner: Integers,
    nodes: Nodes,
    colliders: Nodes,
    room: Scalars,
    touch: Integers,
    sdf: Scalars,
):
    """Move every cloud that may make more than `n` substeps by one of its own."""
    for at in range(BLOCK * ti.min(used[0], owner.shape[0])):
        nodes[at] = Vec4(0.0)
    for i in range(x.shape[0]):
        row = cloud[i]
        if state[row, LIMIT] > n:
            scatter(i, row, x, v, C, b, largest, numbers, counts, state, nodes)
    for at in range(BLOCK * ti.min(used[0], owner.shape[0])):
        row, place, _ = node_at(at, n, state, owner)
        if row >= 0:
            move_node(
                at, row, place, numbers, counts, state, nodes, colliders, touch, room.shape[0]
            )  # fmt: skip
    for i in range(x.shape[0]):
        row = cloud[i]
        if state[row, LIMIT] > n:
            gather(i, row, n, x, v, C, largest, numbers, counts, state, nodes, room, sdf)
