"""MLS-MPM substeps as Taichi functions, and the kernel that runs many of them on one CPU thread.

Quadratic B-splines and APIC (Jiang et al. 2015), MLS stress (Hu et al. 2018). Kernel functions are
longer than elsewhere because a function call is free only when Taichi inlines it.

Everything a kernel needs comes in as arguments, so kernels are compiled once per process whatever
the scene. Grid arrays are flat: node (i, j, k) is number (i ny + j) nz + k and lies at origin +
dx (i, j, k). No atomics: the order of every sum is fixed.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.contact import (
    Contact,
    Grid,
    Int3,
    Vec4,
    coulomb,
    find_fingers,
    finger_local,
    finger_side,
    finger_world,
    sdf_holds,
    sdf_sample,
)
from doughdata.sim.stress import Mat3, Sym, Vec3, hencky_return

__all__ = ["CFL_BROKEN", "LEFT_DOMAIN", "Dough", "advance"]

Scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
Vectors = ti.types.ndarray(dtype=Vec3, ndim=1)
Matrices = ti.types.ndarray(dtype=Mat3, ndim=1)
Symmetrics = ti.types.ndarray(dtype=Sym, ndim=1)
Nodes = ti.types.ndarray(dtype=Vec4, ndim=1)

LEFT_DOMAIN = 1
CFL_BROKEN = 2
EVERY = 5  # substeps between looks at the particles' bounding box and at the fingers
MARGIN = 2  # [cells], of that box: five substeps move a particle by less than 1.75 cells
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
def region_of(x: ti.template(), grid: ti.template(), status: ti.template()):
    """Nodes that particles can reach within the next substeps: first and one past the last."""
    low, high = Int3(1 << 30), Int3(-(1 << 30))
    for i in range(x.shape[0]):
        base = ti.cast(ti.floor((x[i] - grid.origin) * grid.inverse - 0.5), ti.i32)
        low = ti.min(low, base)
        high = ti.max(high, base)
    low = low - MARGIN
    high = high + (3 + MARGIN)
    for d in ti.static(range(3)):
        if low[d] < 0 or high[d] > grid.shape[d]:
            status[0] = LEFT_DOMAIN
            status[1] = d
    return low, high


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
    for i, j, k in ti.ndrange((low[0], high[0]), (low[1], high[1]), (low[2], high[2])):
        colliders[(i * ny + j) * nz + k] = Vec4(0.0)
    for i in range(x.shape[0]):
        base, _, w0, w1, w2 = weights(x[i], grid)
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
def particle_to_grid(
    i,
    dt,
    x: ti.template(),
    v: ti.template(),
    C: ti.template(),
    b: ti.template(),
    largest: ti.template(),
    nodes: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
):
    """Deform a particle and add its momentum and mass to 27 nodes, without atomics."""
    F = dt * C[i] + ti.Matrix.identity(ti.f32, 3)
    s = b[i]
    H = F @ Mat3(s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2])
    trial = Sym(
        H[0, 0] * F[0, 0] + H[0, 1] * F[0, 1] + H[0, 2] * F[0, 2],
        H[1, 0] * F[1, 0] + H[1, 1] * F[1, 1] + H[1, 2] * F[1, 2],
        H[2, 0] * F[2, 0] + H[2, 1] * F[2, 1] + H[2, 2] * F[2, 2],
        H[0, 0] * F[1, 0] + H[0, 1] * F[1, 1] + H[0, 2] * F[1, 2],
        H[1, 0] * F[2, 0] + H[1, 1] * F[2, 1] + H[1, 2] * F[2, 2],
        H[0, 0] * F[2, 0] + H[0, 1] * F[2, 1] + H[0, 2] * F[2, 2],
    )
    new_b, tau = hencky_return(trial, dough.shear, dough.bulk, dough.yield_strain, largest[i])
    b[i] = new_b
    base, f, w0, w1, w2 = weights(x[i], grid)
    k = -4.0 * dt * dough.volume * grid.inverse
    m = dough.mass
    affine = (
        k * Mat3(tau[0], tau[3], tau[5], tau[3], tau[1], tau[4], tau[5], tau[4], tau[2])
        + (m * grid.dx) * C[i]
    )
    ax = Vec3(affine[0, 0], affine[1, 0], affine[2, 0])
    ay = Vec3(affine[0, 1], affine[1, 1], affine[2, 1])
    az = Vec3(affine[0, 2], affine[1, 2], affine[2, 2])
    ny, nz = grid.shape[1], grid.shape[2]
    first = (base[0] * ny + base[1]) * nz + base[2]
    # Momentum is affine in the node's place: each node is its neighbour's plus a constant.
    momentum_x = m * v[i] - affine @ f
    for p in ti.static(range(3)):
        wx = ti.static([w0, w1, w2])[p][0]
        momentum_y = momentum_x + ti.static(float(p)) * ax if ti.static(p > 0) else momentum_x
        for q in ti.static(range(3)):
            w = wx * ti.static([w0, w1, w2])[q][1]
            g0 = momentum_y + ti.static(float(q)) * ay if ti.static(q > 0) else momentum_y
            g1 = g0 + az
            g2 = g1 + az
            at = first + (p * ny + q) * nz
            u0, u1, u2 = w * w0[2], w * w1[2], w * w2[2]
            nodes[at] = nodes[at] + u0 * Vec4(g0[0], g0[1], g0[2], m)
            nodes[at + 1] = nodes[at + 1] + u1 * Vec4(g1[0], g1[1], g1[2], m)
            nodes[at + 2] = nodes[at + 2] + u2 * Vec4(g2[0], g2[1], g2[2], m)


@ti.func
def move_node(
    at,
    k,
    dt,
    fingers,
    nodes: ti.template(),
    colliders: ti.template(),
    total,
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Momentum -> velocity, then gravity, fingers and table."""
    node = nodes[at]
    if node[3] > 0.0:
        u = (1.0 / node[3]) * Vec3(node[0], node[1], node[2])
        u[2] = u[2] - dough.gravity * dt
        if fingers:
            for finger in range(2):
                c = colliders[finger * total + at]
                if c[3] < contact.band:
                    wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                    hit = coulomb(u, wall, Vec3(c[0], c[1], c[2]), contact.friction)
                    u = u + ti.min(1.0, 1.0 - c[3] / contact.band) * (hit - u)
        if dough.driven:
            c = colliders[at]
            # Particles alone would drag the nodes like a viscous fluid, and slip.
            if c[0] + c[1] > 0.5 * c[2]:
                u = ti.select(c[1] > c[0], 1.0, -1.0) * dough.pull
        if k <= grid.table:
            u = coulomb(u, Vec3(0.0), Vec3(0.0, 0.0, 1.0), contact.table_friction)
        nodes[at] = Vec4(u[0], u[1], u[2], node[3])


@ti.func
def grid_to_particle(
    i,
    dt,
    fingers,
    opening,
    x: ti.template(),
    v: ti.template(),
    C: ti.template(),
    largest: ti.template(),
    handles: ti.template(),
    nodes: ti.template(),
    free: ti.template(),
    sdf: ti.template(),
    status: ti.template(),
    grid: ti.template(),
    dough: ti.template(),
    contact: ti.template(),
):
    """Gather velocity, its gradient and density; move; keep out of fingers and table."""
    base, f, w0, w1, w2 = weights(x[i], grid)
    wx, wy, wz = ti.static([w0, w1, w2], [w0, w1, w2], [w0, w1, w2])
    ny, nz = grid.shape[1], grid.shape[2]
    first = (base[0] * ny + base[1]) * nz + base[2]
    sums, sx, sy, sz = Vec4(0.0), Vec3(0.0), Vec3(0.0), Vec3(0.0)
    room = 1.0
    if fingers:
        room = 0.0
        for p in ti.static(range(3)):
            for q in ti.static(range(3)):
                at = grid.shape[0] * ny * nz + first + (p * ny + q) * nz
                column = wz[0][2] * free[at] + wz[1][2] * free[at + 1] + wz[2][2] * free[at + 2]
                room = room + (wx[p][0] * wy[q][1]) * column
    # First moments of the nodes' velocity, one axis after the other.
    for p in ti.static(range(3)):
        plane, plane_y, plane_z = Vec4(0.0), Vec3(0.0), Vec3(0.0)
        for q in ti.static(range(3)):
            at = first + (p * ny + q) * nz
            n0, n1, n2 = nodes[at], nodes[at + 1], nodes[at + 2]
            line = wy[q][1] * (wz[0][2] * n0 + wz[1][2] * n1 + wz[2][2] * n2)
            line_z = (wy[q][1] * wz[1][2]) * n1 + (2.0 * wy[q][1] * wz[2][2]) * n2
            plane = plane + line
            plane_z = plane_z + Vec3(line_z[0], line_z[1], line_z[2])
            if ti.static(q > 0):
                plane_y = plane_y + ti.static(float(q)) * Vec3(line[0], line[1], line[2])
        sums = sums + wx[p][0] * plane
        sy = sy + wx[p][0] * plane_y
        sz = sz + wx[p][0] * plane_z
        if ti.static(p > 0):
            sx = sx + (ti.static(float(p)) * wx[p][0]) * Vec3(plane[0], plane[1], plane[2])
    u = Vec3(sums[0], sums[1], sums[2])
    gradient = Mat3(0.0)
    for d in ti.static(range(3)):
        gradient[d, 0] = (4.0 * grid.inverse) * (sx[d] - sums[d] * f[0])
        gradient[d, 1] = (4.0 * grid.inverse) * (sy[d] - sums[d] * f[1])
        gradient[d, 2] = (4.0 * grid.inverse) * (sz[d] - sums[d] * f[2])
    # Material squeezed closer than its own volume says must not believe that it is stretched.
    reference = (dough.density_cap * dough.mass / dough.volume) * grid.dx * grid.dx * grid.dx
    largest[i] = ti.max(LEAST_VOLUME, reference * ti.max(room, LEAST_FREE) / sums[3])
    if handles[i] > 0:
        u = ti.select(handles[i] == 2, 1.0, -1.0) * dough.pull
    move = dt * u
    if move.dot(move) <= (LONGEST_MOVE * grid.dx) ** 2:  # false for NaN
        moved = x[i] + move
        if fingers:
            for finger in range(2):
                local = finger_local(moved, finger, opening, contact)
                if sdf_holds(local, contact.sdf_spacing, contact):
                    d, gradient_f = sdf_sample(local, sdf, contact)
                    if d < 0.0:
                        normal = finger_world(gradient_f, finger, contact)
                        moved = moved + ti.min(-d, LONGEST_PUSH * grid.dx) * normal
                        wall = finger_side(finger) * (0.5 * contact.rate) * contact.axis
                        u = u - ti.min(0.0, (u - wall).dot(normal)) * normal
        if grid.table >= 0 and moved[2] < 0.0:
            moved[2] = 0.0
            u[2] = ti.max(0.0, u[2])
        x[i] = moved
    elif status[0] == 0:
        status[0] = CFL_BROKEN
        status[1] = i
    v[i] = u
    C[i] = gradient


@ti.kernel
def advance(
    steps: ti.i32,
    dt: ti.f32,
    x: Vectors,
    v: Vectors,
    C: Matrices,
    b: Symmetrics,
    largest: Scalars,
    handles: Integers,
    nodes: Nodes,
    colliders: Nodes,
    free: Scalars,
    sdf: Scalars,
    status: Integers,
    grid: Grid,
    dough: Dough,
    contact: Contact,
):
    """Run substeps on one thread, in a fixed order: bitwise reproducible.

    `status` is (reason, detail); once a reason is set the remaining substeps do nothing.
    """
    ti.loop_config(serialize=True)
    for step in range(steps):
        total = grid.shape[0] * grid.shape[1] * grid.shape[2]
        now = contact.opening + contact.rate * dt * ti.cast(step, ti.f32)
        if status[0] == 0 and step % EVERY == 0:
            low, high = region_of(x, grid, status)
            for d in ti.static(range(3)):
                status[2 + d] = low[d]
                status[5 + d] = high[d]
            if status[0] == 0 and contact.fingers > 0:
                find_fingers(low, high, now, sdf, colliders, free, grid, contact)
            if status[0] == 0 and dough.driven > 0:
                find_handles(low, high, x, handles, colliders, grid)
        if status[0] == 0:
            low = Int3(status[2], status[3], status[4])
            high = Int3(status[5], status[6], status[7])
            for i in range(low[0], high[0]):
                for j in range(low[1], high[1]):
                    row = (i * grid.shape[1] + j) * grid.shape[2]
                    for at in range(row + low[2], row + high[2]):
                        nodes[at] = Vec4(0.0)
            for i in range(x.shape[0]):
                particle_to_grid(i, dt, x, v, C, b, largest, nodes, grid, dough)
            for i in range(low[0], high[0]):
                for j in range(low[1], high[1]):
                    row = (i * grid.shape[1] + j) * grid.shape[2]
                    for k in range(low[2], high[2]):
                        move_node(
                            row + k,
                            k,
                            dt,
                            contact.fingers,
                            nodes,
                            colliders,
                            total,
                            grid,
                            dough,
                            contact,
                        )
            for i in range(x.shape[0]):
                grid_to_particle(
                    i,
                    dt,
                    contact.fingers,
                    now + contact.rate * dt,
                    x,
                    v,
                    C,
                    largest,
                    handles,
                    nodes,
                    free,
                    sdf,
                    status,
                    grid,
                    dough,
                    contact,
                )
