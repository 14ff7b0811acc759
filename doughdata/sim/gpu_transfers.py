"""One substep of MLS-MPM for a GPU as Taichi functions: as `transfers`, with atomics and clouds.

Each function acts on one particle or node of one cloud; see `gpu_kernels` for the arrays.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.contact import (
    Int3,
    Vec4,
    coulomb,
    finger_local,
    finger_side,
    finger_world,
    sdf_holds,
)
from doughdata.sim.gpu_rows import (
    DETAIL,
    FIRST,
    LIMIT,
    LOW,
    STATUS,
    box_of,
    opening_now,
    row_contact,
    row_count,
    row_dough,
    row_grid,
    row_number,
    sdf_sample_from,
)
from doughdata.sim.stress import Mat3, Sym, Vec3, hencky_return
from doughdata.sim.transfers import (
    CFL_BROKEN,
    LEAST_FREE,
    LEAST_VOLUME,
    LONGEST_MOVE,
    LONGEST_PUSH,
    weights,
)

__all__ = ["gather", "move_node", "scatter", "spline"]


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
