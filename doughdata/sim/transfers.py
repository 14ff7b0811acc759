"""One substep of MLS-MPM as Taichi functions: particles to grid, grid motion, grid to particles.

Quadratic B-splines and APIC (Jiang et al. 2015), MLS stress (Hu et al. 2018). Functions are longer
than elsewhere because a call is free only when Taichi inlines it.

Grid arrays are flat: node (i, j, k) is number (i ny + j) nz + k and lies at origin + dx (i, j, k).
A particle's state lies in rows of four floats, which LLVM turns into vector instructions:
`x[i]` is (x, y, z, largest J), `motion[4 i]` (vx, vy, vz, 1) and `motion[4 i + 1 + d]` dv/dx_d.
LLVM must see that a row does not cross the end of 32-bit numbers: hence powers of two.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.contact import (
    Vec4,
    coulomb,
    finger_local,
    finger_side,
    finger_world,
    sdf_near,
    sdf_sample,
)
from doughdata.sim.stress import Sym, Vec3, hencky_return

__all__ = [
    "CFL_BROKEN",
    "LEFT_DOMAIN",
    "Dough",
    "grid_to_particle",
    "move_node",
    "particle_to_grid",
    "position_of",
    "weights",
]

LEFT_DOMAIN = 1
CFL_BROKEN = 2
LONGEST_MOVE = 0.25  # [cells] per substep; more is a broken time-step limit
LONGEST_PUSH = 0.1  # [cells] per substep, out of a finger
LEAST_FREE = 0.02  # tool-free volume fraction is kept above, against division by zero
LEAST_VOLUME = 0.3  # J is never limited below


@ti.dataclass
class Dough:
    """Material and particles."""

    shear: ti.f32  # [Pa]
    bulk: ti.f32  # [Pa]
    yield_strain: ti.f32  # largest norm of the logarithmic deviator
    volume: ti.f32  # [m3] per particle
    mass: ti.f32  # [kg] per particle
    gravity: ti.f32  # [m/s2]
    density_cap: ti.f32  # J is limited to this times the particle's reference over its real density
    driven: ti.i32  # whether any particle is a handle
    pull: Vec3  # [m/s], of handle 2; handle 1 moves against it


@ti.func
def position_of(row):
    """The position [m] in a row of `x`."""
    return Vec3(row[0], row[1], row[2])


@ti.func
def weights(point, grid: ti.template()):
    """First of the three nodes an axis, position relative to it [cells], B-spline weights."""
    u = (point - grid.origin) * grid.inverse
    base = ti.cast(u - 0.5, ti.i32)
    f = u - ti.cast(base, ti.f32)
    w0 = 0.5 * (1.5 - f) * (1.5 - f)
    w1 = 0.75 - (f - 1.0) * (f - 1.0)
    w2 = 0.5 * (f - 0.5) * (f - 0.5)
    return base, f, w0, w1, w2


@ti.func
def particle_to_grid(
    i,
    dt,
    shift,
    x: ti.template(),
    motion: ti.template(),
    b: ti.template(),
    nodes: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
):
    """Deform a particle and add its momentum and mass to 27 nodes, without atomics.

    `shift` is the first row of the slice's own grid in `nodes`.
    """
    c0, c1, c2 = motion[4 * i + 1], motion[4 * i + 2], motion[4 * i + 3]
    f0 = dt * c0 + Vec4(1.0, 0.0, 0.0, 0.0)
    f1 = dt * c1 + Vec4(0.0, 1.0, 0.0, 0.0)
    f2 = dt * c2 + Vec4(0.0, 0.0, 1.0, 0.0)
    s = b[i]
    h0 = s[0] * f0 + s[3] * f1 + s[5] * f2
    h1 = s[3] * f0 + s[1] * f1 + s[4] * f2
    h2 = s[5] * f0 + s[4] * f1 + s[2] * f2
    trial = Sym(
        h0[0] * f0[0] + h1[0] * f1[0] + h2[0] * f2[0],
        h0[1] * f0[1] + h1[1] * f1[1] + h2[1] * f2[1],
        h0[2] * f0[2] + h1[2] * f1[2] + h2[2] * f2[2],
        h0[0] * f0[1] + h1[0] * f1[1] + h2[0] * f2[1],
        h0[1] * f0[2] + h1[1] * f1[2] + h2[1] * f2[2],
        h0[0] * f0[2] + h1[0] * f1[2] + h2[0] * f2[2],
    )
    row = x[i]
    new_b, tau = hencky_return(trial, dough.shear, dough.bulk, dough.yield_strain, row[3])
    b[i] = new_b
    base, f, w0, w1, w2 = weights(position_of(row), grid)
    k = -4.0 * dt * dough.volume * grid.inverse
    m = dough.mass
    inertia = Vec4(m * grid.dx, m * grid.dx, m * grid.dx, 0.0)
    ax = k * Vec4(tau[0], tau[3], tau[5], 0.0) + inertia * c0
    ay = k * Vec4(tau[3], tau[1], tau[4], 0.0) + inertia * c1
    az = k * Vec4(tau[5], tau[4], tau[2], 0.0) + inertia * c2
    ny, nz = grid.shape[1], grid.shape[2]
    first = shift + (base[0] * ny + base[1]) * nz + base[2]
    # Momentum is affine in the node's place: each node is its neighbour's plus a constant. The
    # fourth lane carries the mass, the same at every node.
    plane = m * motion[4 * i] - (f[0] * ax + f[1] * ay + f[2] * az)
    for p in ti.static(range(3)):
        g0 = plane
        for q in ti.static(range(3)):
            w = ti.static([w0, w1, w2])[p][0] * ti.static([w0, w1, w2])[q][1]
            at = first + (p * ny + q) * nz
            g1 = g0 + az
            g2 = g1 + az
            nodes[at] = nodes[at] + (w * w0[2]) * g0
            nodes[at + 1] = nodes[at + 1] + (w * w1[2]) * g1
            nodes[at + 2] = nodes[at + 2] + (w * w2[2]) * g2
            if ti.static(q < 2):
                g0 = g0 + ay
        if ti.static(p < 2):
            plane = plane + ax


@ti.func
def move_node(
    at,
    k,
    dt,
    total,
    nodes: ti.template(),
    colliders: ti.template(),
    touch: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Momentum -> velocity, then gravity, and the fingers and table that dough here touches."""
    node = nodes[at]
    if node[3] > 0.0:
        u = (1.0 / node[3]) * Vec3(node[0], node[1], node[2])
        u[2] = u[2] - dough.gravity * dt
        walls = touch[at]
        if contact.fingers:
            for finger in range(2):
                c = colliders[finger * total + at]
                if (walls & (1 << finger)) > 0 and c[3] < contact.band:
                    wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                    hit = coulomb(u, wall, Vec3(c[0], c[1], c[2]), contact.friction)
                    u = u + ti.min(1.0, 1.0 - c[3] / contact.band) * (hit - u)
        if dough.driven:
            c = colliders[at]
            # Particles alone would drag the nodes like a viscous fluid, and slip.
            if c[0] + c[1] > 0.5 * c[2]:
                u = ti.select(c[1] > c[0], 1.0, -1.0) * dough.pull
        if k <= grid.table and (walls & 4) > 0:
            u = coulomb(u, Vec3(0.0), Vec3(0.0, 0.0, 1.0), contact.table_friction)
        nodes[at] = Vec4(u[0], u[1], u[2], node[3])


@ti.func
def room_of(first, shift, w0, w1, w2, free: ti.template(), grid: ti.template()):
    """Tool-free volume fraction around a particle whose first node is `first`."""
    room = 0.0
    for p in range(3):  # a true loop: seldom run, and less to compile
        wx = ti.select(p == 0, w0[0], ti.select(p == 1, w1[0], w2[0]))
        for q in range(3):
            at = shift + first + (p * grid.shape[1] + q) * grid.shape[2]
            column = w0[2] * free[at] + w1[2] * free[at + 1] + w2[2] * free[at + 2]
            room = room + wx * ti.select(q == 0, w0[1], ti.select(q == 1, w1[1], w2[1])) * column
    return room


@ti.func
def gather_moments(
    i,
    first,
    w0,
    w1,
    w2,
    motion: ti.template(),
    nodes: ti.template(),
    grid: ti.template(),
):
    """Sums of the nodes' rows and their first moments into the rows of `motion`.

    LLVM finds vector instructions from rows that are stored, and only where the same row was read
    before: hence sums in memory, and the old row times zero (NaN stays NaN).
    """
    w = ti.static([w0, w1, w2])
    for p in ti.static(range(3)):
        plane, plane_y, plane_z = Vec4(0.0), Vec4(0.0), Vec4(0.0)
        for q in ti.static(range(3)):
            at = first + (p * grid.shape[1] + q) * grid.shape[2]
            last = w2[2] * nodes[at + 2]
            upper = w1[2] * nodes[at + 1] + last
            line = w[q][1] * (w0[2] * nodes[at] + upper)
            line_z = w[q][1] * (upper + last)
            plane = plane + line
            plane_z = plane_z + line_z
            if ti.static(q == 1):
                plane_y = line
            if ti.static(q == 2):
                plane_y = plane_y + 2.0 * line
        keep = ti.static(0.0 if p == 0 else 1.0)
        motion[4 * i] = keep * motion[4 * i] + w[p][0] * plane
        motion[4 * i + 2] = keep * motion[4 * i + 2] + w[p][0] * plane_y
        motion[4 * i + 3] = keep * motion[4 * i + 3] + w[p][0] * plane_z
        if ti.static(p > 0):
            keep_x = ti.static(0.0 if p == 1 else 1.0)
            moment = (ti.static(float(p)) * w[p][0]) * plane
            motion[4 * i + 1] = keep_x * motion[4 * i + 1] + moment


@ti.func
def grid_to_particle(
    i,
    dt,
    opening,
    x: ti.template(),
    motion: ti.template(),
    handles: ti.template(),
    nodes: ti.template(),
    free: ti.template(),
    sdf: ti.template(),
    boxes: ti.template(),
    near,
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Gather velocity, its gradient and density; move; keep out of fingers and table.

    `near` is where the box of nodes that a finger takes volume from begins in `boxes`. Returns
    whether the particle broke the time-step limit.
    """
    row = x[i]
    place = position_of(row)
    base, f, w0, w1, w2 = weights(place, grid)
    first = (base[0] * grid.shape[1] + base[1]) * grid.shape[2] + base[2]
    gather_moments(i, first, w0, w1, w2, motion, nodes, grid)
    sums = motion[4 * i]
    k = 4.0 * grid.inverse
    motion[4 * i + 1] = k * (motion[4 * i + 1] - f[0] * sums)
    motion[4 * i + 2] = k * (motion[4 * i + 2] - f[1] * sums)
    motion[4 * i + 3] = k * (motion[4 * i + 3] - f[2] * sums)
    room = 1.0
    if contact.fingers:
        inside = 1
        for d in ti.static(range(3)):
            if base[d] + 3 <= boxes[near + d] or base[d] >= boxes[near + 3 + d]:
                inside = 0
        if inside:
            total = grid.shape[0] * grid.shape[1] * grid.shape[2]
            room = room_of(first, total, w0, w1, w2, free, grid)
    # Material squeezed closer than its own volume says must not believe that it is stretched.
    reference = (dough.density_cap * dough.mass / dough.volume) * grid.dx * grid.dx * grid.dx
    largest = ti.max(LEAST_VOLUME, reference * ti.max(room, LEAST_FREE) / sums[3])
    u = Vec3(sums[0], sums[1], sums[2])
    if handles[i] > 0:
        u = ti.select(handles[i] == 2, 1.0, -1.0) * dough.pull
    move = dt * u
    moved = place
    broken = 1
    if move.dot(move) <= (LONGEST_MOVE * grid.dx) ** 2:  # false for NaN
        broken = 0
        moved = place + move
        if contact.fingers:
            for finger in range(2):
                local = finger_local(moved, finger, opening, contact)
                if sdf_near(local, contact.sdf_spacing, 0.0, contact):
                    d, gradient = sdf_sample(local, sdf, contact)
                    if d < 0.0:
                        normal = finger_world(gradient, finger, contact)
                        moved = moved + ti.min(-d, LONGEST_PUSH * grid.dx) * normal
                        wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                        u = u - ti.min(0.0, (u - wall).dot(normal)) * normal
        if grid.table >= 0 and moved[2] < 0.0:
            moved[2] = 0.0
            u[2] = ti.max(0.0, u[2])
    x[i] = Vec4(moved[0], moved[1], moved[2], largest)
    motion[4 * i] = Vec4(u[0], u[1], u[2], 1.0)
    return broken
