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
from doughdata.sim.contact import (
    FAR,
    Int3,
    Vec4,
    coulomb,
    finger_local,
    finger_side,
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
    row_dough,
    row_grid,
    row_number,
    sdf_sample_from,
)
from doughdata.sim.kernels import (
    CFL_BROKEN,
    LEAST_FREE,
    LEAST_VOLUME,
    LEFT_DOMAIN,
    LONGEST_MOVE,
    LONGEST_PUSH,
    MARGIN,
    weights,
)
from doughdata.sim.stress import Mat3, Sym, Vec3, hencky_return

__all__ = ["look", "substep"]

Scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
Vectors = ti.types.ndarray(dtype=Vec3, ndim=1)
Matrices = ti.types.ndarray(dtype=Mat3, ndim=1)
Symmetrics = ti.types.ndarray(dtype=Sym, ndim=1)
Nodes = ti.types.ndarray(dtype=Vec4, ndim=1)
Numbers = ti.types.ndarray(dtype=ti.f32, ndim=2)
Counts = ti.types.ndarray(dtype=ti.i32, ndim=2)

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


@ti.func
def spline(p, q, r, w0, w1, w2):
    """B-spline weight of one of the 27 nodes around a particle."""
    wx = ti.select(p == 0, w0[0], ti.select(p == 1, w1[0], w2[0]))
    wy = ti.select(q == 0, w0[1], ti.select(q == 1, w1[1], w2[1]))
    wz = ti.select(r == 0, w0[2], ti.select(r == 1, w1[2], w2[2]))
    return wx * wy * wz


@ti.func
def scatter(
    i,
    row,
    x: ti.template(),
    v: ti.template(),
    C: ti.template(),
    b: ti.template(),
    largest: ti.template(),
    numbers: ti.template(),
    counts: ti.template(),
    state: ti.template(),
    nodes: ti.template(),
):
    """Deform a particle and add its momentum and mass to 27 nodes."""
    grid, dough = row_grid(row, numbers, counts), row_dough(row, numbers)
    dt = row_number(row, "dt", numbers)
    F = dt * C[i] + ti.Matrix.identity(ti.f32, 3)
    s = b[i]
    H = F @ Mat3(s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2]) @ F.transpose()
    trial = Sym(H[0, 0], H[1, 1], H[2, 2], H[0, 1], H[1, 2], H[0, 2])
    new_b, tau = hencky_return(trial, dough.shear, dough.bulk, dough.yield_strain, largest[i])
    b[i] = new_b
    base, f, w0, w1, w2 = weights(x[i], grid)
    stress = Mat3(tau[0], tau[3], tau[5], tau[3], tau[1], tau[4], tau[5], tau[4], tau[2])
    k = -4.0 * dt * dough.volume * grid.inverse
    affine = k * stress + (dough.mass * grid.dx) * C[i]
    low, size = box_of(row, state)
    rel = base - low
    first = state[row, FIRST] + (rel[0] * size[1] + rel[1]) * size[2] + rel[2]
    momentum = dough.mass * v[i] - affine @ f
    for p, q, r in ti.ndrange(3, 3, 3):
        w = spline(p, q, r, w0, w1, w2)
        g = w * (momentum + affine @ ti.cast(Int3(p, q, r), ti.f32))
        at = first + (p * size[1] + q) * size[2] + r
        ti.atomic_add(nodes[at], Vec4(g[0], g[1], g[2], w * dough.mass))


@ti.func
def move_node(
    at,
    row,
    place,
    numbers: ti.template(),
    counts: ti.template(),
    state: ti.template(),
    nodes: ti.template(),
    colliders: ti.template(),
    touch: ti.template(),
    total,
):
    """Momentum -> velocity, then gravity, and the fingers and table that dough here touches."""
    node = nodes[at]
    if node[3] > 0.0:
        dt, contact = row_number(row, "dt", numbers), row_contact(row, numbers, counts)
        u = (1.0 / node[3]) * Vec3(node[0], node[1], node[2])
        u[2] = u[2] - row_number(row, "gravity", numbers) * dt
        if contact.fingers > 0:
            for finger in range(2):
                c = colliders[finger * total + at]
                if (touch[at] & (1 << finger)) > 0 and c[3] < contact.band:
                    wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                    hit = coulomb(u, wall, Vec3(c[0], c[1], c[2]), contact.friction)
                    u = u + ti.min(1.0, 1.0 - c[3] / contact.band) * (hit - u)
        k = state[row, LOW + 2] + place[2]
        if k <= row_count(row, "table", counts) and (touch[at] & 4) > 0:
            u = coulomb(u, Vec3(0.0), Vec3(0.0, 0.0, 1.0), contact.table_friction)
        nodes[at] = Vec4(u[0], u[1], u[2], node[3])


@ti.func
def gather(
    i,
    row,
    n,
    x: ti.template(),
    v: ti.template(),
    C: ti.template(),
    largest: ti.template(),
    numbers: ti.template(),
    counts: ti.template(),
    state: ti.template(),
    nodes: ti.template(),
    room: ti.template(),
    sdf: ti.template(),
):
    """Gather velocity, its gradient and density; move; keep out of fingers and table."""
    grid, dough = row_grid(row, numbers, counts), row_dough(row, numbers)
    contact, dt = row_contact(row, numbers, counts), row_number(row, "dt", numbers)
    base, f, w0, w1, w2 = weights(x[i], grid)
    low, size = box_of(row, state)
    rel = base - low
    first = state[row, FIRST] + (rel[0] * size[1] + rel[1]) * size[2] + rel[2]
    u, gradient, density, free = Vec3(0.0), Mat3(0.0), 0.0, 1.0
    for p, q, r in ti.ndrange(3, 3, 3):
        node = spline(p, q, r, w0, w1, w2) * nodes[first + (p * size[1] + q) * size[2] + r]
        part = Vec3(node[0], node[1], node[2])
        u = u + part
        gradient = gradient + part.outer_product(ti.cast(Int3(p, q, r), ti.f32) - f)
        density = density + node[3]
    if contact.fingers > 0:
        free = 0.0
        for p, q, r in ti.ndrange(3, 3, 3):
            at = first + (p * size[1] + q) * size[2] + r
            free = free + spline(p, q, r, w0, w1, w2) * room[at]
    # Material squeezed closer than its own volume says must not believe that it is stretched.
    reference = (dough.density_cap * dough.mass / dough.volume) * grid.dx * grid.dx * grid.dx
    largest[i] = ti.max(LEAST_VOLUME, reference * ti.max(free, LEAST_FREE) / density)
    move = dt * u
    if move.dot(move) <= (LONGEST_MOVE * grid.dx) ** 2:  # false for NaN
        moved = x[i] + move
        if contact.fingers > 0:
            opening = opening_now(row, n, numbers, counts) + contact.rate * dt
            for finger in range(2):
                local = finger_local(moved, finger, opening, contact)
                if sdf_holds(local, contact.sdf_spacing, contact):
                    sdf_first = row_count(row, "sdf_first", counts)
                    d, slope = sdf_sample_from(sdf_first, local, sdf, contact)
                    if d < 0.0:
                        normal = finger_world(slope, finger, contact)
                        moved = moved + ti.min(-d, LONGEST_PUSH * grid.dx) * normal
                        wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                        u = u - ti.min(0.0, (u - wall).dot(normal)) * normal
        if grid.table >= 0 and moved[2] < 0.0:
            moved[2] = 0.0
            u[2] = ti.max(0.0, u[2])
        x[i] = moved
    else:
        # The cloud's other particles end this substep too: the first to fail is always the same.
        state[row, STATUS] = CFL_BROKEN
        ti.atomic_min(state[row, LIMIT], n + 1)
        ti.atomic_min(state[row, DETAIL], i)
    v[i] = u
    C[i] = (4.0 * grid.inverse) * gradient
