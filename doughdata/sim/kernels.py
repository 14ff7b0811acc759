"""Kernels that run substeps of MLS-MPM on the CPU: `look`, then `advance` by up to EVERY of them.

Everything a kernel needs comes in as arguments, so kernels are compiled once per process whatever
the scene. See `transfers` for the layout of particles and nodes.

Particles are sorted by cell and cut into SLICES slices of one length. Each slice scatters into a
grid of its own, within its own box, and the grids are summed slice after slice. There are no
atomics, so the order of every sum is fixed, whatever the number of threads. `boxes` holds (first,
one past the last) node of each slice, of all particles, and of what fingers take volume from.
`status` holds (reason, detail) of each slice; once there is a reason, particles stay.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.arrays import Integers, Nodes, Scalars, Symmetrics
from doughdata.sim.contact import (
    Contact,
    Grid,
    Int3,
    Vec4,
    find_fingers,
    find_touch,
)
from doughdata.sim.transfers import (
    CFL_BROKEN,
    LEFT_DOMAIN,
    Dough,
    grid_to_particle,
    move_node,
    particle_to_grid,
    position_of,
    weights,
)

__all__ = ["ALL", "EVERY", "MARGIN", "NEAR", "SLICES", "advance", "look"]


SLICES = 4
ALL = 6 * SLICES  # where the box of all particles begins in `boxes`
NEAR = ALL + 6  # and that of the nodes whose volume a finger takes
EVERY = 5  # substeps between looks at the particles' boxes and at the fingers
MARGIN = 2  # [cells], of the boxes: five substeps move a particle by less than 1.75 cells
MOST = (1 << 26) - 1  # changes no index, but proves that 16 i is a 32-bit number: see `transfers`
PAD = 512  # iterations that one thread takes of a loop: Taichi gives no thread fewer


@ti.func
def running(status: ti.template()):
    """Whether no slice has a reason to stop."""
    good = 1
    for s in range(SLICES):
        if status[2 * s] != 0:
            good = 0
    return good


@ti.func
def region_of(begin, end, x: ti.template(), grid: ti.template()):
    """Nodes that particles can reach within the next substeps: first and one past the last."""
    low, high = Int3(1 << 30), Int3(-(1 << 30))
    for i in range(begin, end):
        base = ti.cast(ti.floor((position_of(x[i]) - grid.origin) * grid.inverse - 0.5), ti.i32)
        low = ti.min(low, base)
        high = ti.max(high, base)
    return low - MARGIN, high + (3 + MARGIN)


@ti.func
def find_regions(
    x: ti.template(), boxes: ti.template(), status: ti.template(), grid: ti.template()
):
    """Boxes of the slices and of all particles; a status where one leaves the grid."""
    first, last = grid.shape, Int3(0)
    for s in range(SLICES):
        low, high = region_of((s * x.shape[0]) // SLICES, ((s + 1) * x.shape[0]) // SLICES, x, grid)
        for d in ti.static(range(3)):
            boxes[6 * s + d] = low[d]
            boxes[6 * s + 3 + d] = high[d]
            if low[d] < high[d] and (low[d] < 0 or high[d] > grid.shape[d]):
                status[2 * s] = LEFT_DOMAIN
                status[2 * s + 1] = d
        first = ti.min(first, low)
        last = ti.max(last, high)
    for d in ti.static(range(3)):
        boxes[ALL + d] = first[d]
        boxes[ALL + 3 + d] = last[d]


@ti.func
def find_near(low, high, free: ti.template(), boxes: ti.template(), grid: ti.template()):
    """The box of all nodes whose volume a finger takes a part of."""
    total = grid.shape[0] * grid.shape[1] * grid.shape[2]
    first, last = high, low
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            row = total + (i * grid.shape[1] + j) * grid.shape[2]
            for k in range(low[2], high[2]):
                if free[row + k] != 1.0:
                    first = ti.min(first, Int3(i, j, k))
                    last = ti.max(last, Int3(i, j, k) + 1)
    for d in ti.static(range(3)):
        boxes[NEAR + d] = first[d]
        boxes[NEAR + 3 + d] = last[d]


@ti.func
def find_handles(
    low,
    high,
    x: ti.template(),
    handles: ti.template(),
    colliders: ti.template(),
    grid: ti.template(),
):
    """Share of handle 1, handle 2 and all particles at the nodes, in units of a particle."""
    ny, nz = grid.shape[1], grid.shape[2]
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for at in range((i * ny + j) * nz + low[2], (i * ny + j) * nz + high[2]):
                colliders[at] = Vec4(0.0)
    for i in range(x.shape[0]):
        base, _, w0, w1, w2 = weights(position_of(x[i]), grid)
        kind = Vec4(handles[i] == 1, handles[i] == 2, 1.0, 0.0)
        for p in range(3):
            for q in range(3):
                for r in range(3):
                    wx = ti.select(p == 0, w0[0], ti.select(p == 1, w1[0], w2[0]))
                    wy = ti.select(q == 0, w0[1], ti.select(q == 1, w1[1], w2[1]))
                    wz = ti.select(r == 0, w0[2], ti.select(r == 1, w1[2], w2[2]))
                    at = ((base[0] + p) * ny + base[1] + q) * nz + base[2] + r
                    colliders[at] = colliders[at] + (wx * wy * wz) * kind


@ti.func
def survey(
    opening,
    x: ti.template(),
    handles: ti.template(),
    colliders: ti.template(),
    free: ti.template(),
    touch: ti.template(),
    sdf: ti.template(),
    boxes: ti.template(),
    status: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Where particles, fingers and handles are: holds for the next EVERY substeps."""
    find_regions(x, boxes, status, grid)
    if running(status):
        low = Int3(boxes[ALL], boxes[ALL + 1], boxes[ALL + 2])
        high = Int3(boxes[ALL + 3], boxes[ALL + 4], boxes[ALL + 5])
        if contact.fingers > 0:
            find_fingers(low, high, opening, sdf, colliders, free, grid, contact)
            find_near(low, high, free, boxes, grid)
        if contact.fingers > 0 or grid.table >= 0:
            find_touch(low, high, opening, x, sdf, touch, grid, contact)
        if dough.driven > 0:
            find_handles(low, high, x, handles, colliders, grid)


@ti.func
def scatter(
    s,
    dt,
    x: ti.template(),
    motion: ti.template(),
    b: ti.template(),
    parts: ti.template(),
    boxes: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
):
    """Momentum and mass of one slice, on its own grid."""
    shift = s * grid.shape[0] * grid.shape[1] * grid.shape[2]
    for i in range(boxes[6 * s], boxes[6 * s + 3]):
        for j in range(boxes[6 * s + 1], boxes[6 * s + 4]):
            row = shift + (i * grid.shape[1] + j) * grid.shape[2]
            for at in range(row + boxes[6 * s + 2], row + boxes[6 * s + 5]):
                parts[at] = Vec4(0.0)
    for n in range((s * x.shape[0]) // SLICES, ((s + 1) * x.shape[0]) // SLICES):
        i = n & MOST
        particle_to_grid(i, dt, shift, x, motion, b, parts, grid, dough)


@ti.func
def move_layer(
    i,
    dt,
    parts: ti.template(),
    nodes: ti.template(),
    colliders: ti.template(),
    touch: ti.template(),
    boxes: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Sum the slices' grids on one layer of nodes, then move the nodes."""
    total = grid.shape[0] * grid.shape[1] * grid.shape[2]
    for j in range(boxes[ALL + 1], boxes[ALL + 4]):
        row = (i * grid.shape[1] + j) * grid.shape[2]
        for k in range(boxes[ALL + 2], boxes[ALL + 5]):
            nodes[row + k] = Vec4(0.0)
        for s in range(SLICES):
            across = boxes[6 * s] <= i and i < boxes[6 * s + 3]
            if across and boxes[6 * s + 1] <= j and j < boxes[6 * s + 4]:
                for k in range(boxes[6 * s + 2], boxes[6 * s + 5]):
                    nodes[row + k] = nodes[row + k] + parts[s * total + row + k]
        for k in range(boxes[ALL + 2], boxes[ALL + 5]):
            move_node(row + k, k, dt, total, nodes, colliders, touch, grid, dough, contact)


@ti.func
def gather(
    s,
    dt,
    opening,
    x: ti.template(),
    motion: ti.template(),
    handles: ti.template(),
    nodes: ti.template(),
    free: ti.template(),
    sdf: ti.template(),
    boxes: ti.template(),
    status: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Move the particles of one slice."""
    for n in range((s * x.shape[0]) // SLICES, ((s + 1) * x.shape[0]) // SLICES):
        i = n & MOST
        broken = grid_to_particle(
            i, dt, opening, x, motion, handles, nodes, free, sdf, boxes, NEAR, grid, dough, contact
        )
        if broken and status[2 * s] == 0:
            status[2 * s] = CFL_BROKEN
            status[2 * s + 1] = i


@ti.func
def meet(clock: ti.template(), threads: ti.template()):
    """Wait until every thread is here: `clock[2]` counts arrivals in this launch."""
    if ti.static(threads > 1):
        arrived = ti.atomic_add(clock[2], 1) + 1
        awaited = ((arrived + threads - 1) // threads) * threads
        while ti.atomic_add(clock[2], 0) < awaited:
            pass


@ti.kernel
def look(
    clock: Integers,  # [0] = number of the substep: bound once, changed by the caller
    dt: ti.f32,
    x: Nodes,
    handles: Integers,
    colliders: Nodes,
    free: Scalars,
    touch: Integers,
    sdf: Scalars,
    boxes: Integers,
    status: Integers,
    grid: Grid,
    dough: Dough,
    contact: Contact,
):
    """Before every EVERY-th substep, on one thread: see `survey`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        now = contact.opening + contact.rate * dt * ti.cast(clock[0], ti.f32)
        survey(now, x, handles, colliders, free, touch, sdf, boxes, status, grid, dough, contact)


@ti.kernel
def advance(
    threads: ti.template(),
    clock: Integers,  # number of the first substep, how many, arrivals (see `meet`)
    dt: ti.f32,
    x: Nodes,
    motion: Nodes,
    b: Symmetrics,
    handles: Integers,
    parts: Nodes,
    nodes: Nodes,
    colliders: Nodes,
    free: Scalars,
    touch: Integers,
    sdf: Scalars,
    boxes: Integers,
    status: Integers,
    grid: Grid,
    dough: Dough,
    contact: Contact,
):
    """Up to EVERY substeps on all threads; each has a share of the slices and of the layers.

    Threads meet by counting, awake: three loops that Taichi starts and ends take 0.27 ms a substep.
    Where other work holds a core, one thread is faster.
    """
    ti.loop_config(serialize=ti.static(threads == 1), block_dim=PAD)
    for n in range(threads * PAD):
        if n % PAD == 0:
            me = n // PAD
            for step in range(clock[0], clock[0] + clock[1]):
                now = contact.opening + contact.rate * dt * ti.cast(step, ti.f32)
                if running(status):
                    for s in range((me * SLICES) // threads, ((me + 1) * SLICES) // threads):
                        scatter(s, dt, x, motion, b, parts, boxes, grid, dough)
                    meet(clock, threads)
                    begin, layers = boxes[ALL], boxes[ALL + 3] - boxes[ALL]
                    for i in range(
                        begin + (me * layers) // threads, begin + ((me + 1) * layers) // threads
                    ):
                        move_layer(
                            i, dt, parts, nodes, colliders, touch, boxes, grid, dough, contact
                        )
                    meet(clock, threads)
                    for s in range((me * SLICES) // threads, ((me + 1) * SLICES) // threads):
                        gather(
                            s, dt, now + contact.rate * dt, x, motion, handles,
                            nodes, free, sdf, boxes, status, grid, dough, contact,
                        )  # fmt: skip
                    meet(clock, threads)
