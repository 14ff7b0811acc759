"""Rigid fingers and table as Taichi functions: frames, distances, Coulomb contact, free volume."""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from doughdata.sim._taichi import ti
from doughdata.sim.stress import Vec3

__all__ = [
    "Contact",
    "Grid",
    "Int3",
    "Vec4",
    "coulomb",
    "find_fingers",
    "find_touch",
    "finger_local",
    "finger_side",
    "finger_world",
    "sdf_distance",
    "sdf_holds",
    "sdf_near",
    "sdf_sample",
]

Vec4 = ti.types.vector(4, ti.f32)
Int3 = ti.types.vector(3, ti.i32)
FAR = 1e3  # [m], distance of a node that no finger can touch
CELL = 0.7  # [cells], a finger this far from a node cuts none of the node's eight samples: 0.683


@ti.dataclass
class Grid:
    """Where the background grid lies."""

    origin: Vec3  # [m]
    dx: ti.f32  # [m]
    inverse: ti.f32  # [1/m], 1 / dx
    shape: Int3
    table: ti.i32  # index k of the layer of nodes at z = 0; -1 without a table


@ti.dataclass
class Contact:
    """Both fingers, their signed distance and the table."""

    fingers: ti.i32  # 0 or 2
    gap: Vec3  # [m], middle of the gap
    axis: Vec3  # unit vector, closing axis
    opening: ti.f32  # [m], at the first substep
    rate: ti.f32  # [m/s], of the opening; negative while it closes
    friction: ti.f32
    table_friction: ti.f32
    reach: ti.f32  # [m], a particle this near a wall touches it
    band: ti.f32  # [m], over which a finger's influence on nodes fades
    sdf_origin: Vec3  # [m], finger frame
    sdf_spacing: ti.f32  # [m]
    sdf_shape: Int3
    sdf_beyond: ti.f32  # [m], the finger lies at least this far within its distance grid


@ti.func
def finger_side(finger):
    """Which way a finger lies along the closing axis."""
    return ti.select(finger == 0, 1.0, -1.0)


@ti.func
def finger_local(point, finger, opening, contact: ti.template()):
    """World -> finger frame [m]."""
    side = finger_side(finger)
    r = point - contact.gap
    along = contact.axis[0] * r[0] + contact.axis[1] * r[1]
    lateral = contact.axis[0] * r[1] - contact.axis[1] * r[0]
    return Vec3(side * along - 0.5 * opening, side * lateral, r[2])


@ti.func
def finger_world(vector, finger, contact: ti.template()):
    """Direction: finger frame -> world."""
    side = finger_side(finger)
    along, lateral = side * vector[0], side * vector[1]
    c, s = contact.axis[0], contact.axis[1]
    return Vec3(c * along - s * lateral, s * along + c * lateral, vector[2])


@ti.func
def sdf_holds(local, margin, contact: ti.template()):
    """Whether a point [m] lies in the distance grid, `margin` [m] away from its border."""
    inside = 1
    for d in ti.static(range(3)):
        high = contact.sdf_origin[d] + contact.sdf_spacing * (contact.sdf_shape[d] - 1)
        if local[d] < contact.sdf_origin[d] + margin or local[d] > high - margin:
            inside = 0
    return inside


@ti.func
def sdf_near(local, margin, reach, contact: ti.template()):
    """`sdf_holds`, and the sampled distance may be below `reach` [m]: false only where it is not.

    A node of the grid is no nearer to the finger than to the finger's box, and the nodes around a
    point are at most a spacing nearer to it than the point.
    """
    empty = contact.sdf_beyond - reach - contact.sdf_spacing
    return sdf_holds(local, ti.max(margin, empty), contact)


@ti.func
def sdf_sample(local, sdf: ti.template(), contact: ti.template()):
    """Trilinear distance [m] and its unit gradient, both in the finger frame."""
    u = (local - contact.sdf_origin) / contact.sdf_spacing
    low = Int3(0, 0, 0)
    for d in ti.static(range(3)):
        low[d] = ti.max(0, ti.min(ti.cast(u[d], ti.i32), contact.sdf_shape[d] - 2))
    f = u - ti.cast(low, ti.f32)
    ny, nz = contact.sdf_shape[1], contact.sdf_shape[2]
    at = (low[0] * ny + low[1]) * nz + low[2]
    s000, s001 = sdf[at], sdf[at + 1]
    s010, s011 = sdf[at + nz], sdf[at + nz + 1]
    s100, s101 = sdf[at + ny * nz], sdf[at + ny * nz + 1]
    s110, s111 = sdf[at + ny * nz + nz], sdf[at + ny * nz + nz + 1]
    a00, a01 = s000 + (s001 - s000) * f[2], s010 + (s011 - s010) * f[2]
    a10, a11 = s100 + (s101 - s100) * f[2], s110 + (s111 - s110) * f[2]
    b0, b1 = a00 + (a01 - a00) * f[1], a10 + (a11 - a10) * f[1]
    z0 = (s001 - s000) * (1.0 - f[1]) + (s011 - s010) * f[1]
    z1 = (s101 - s100) * (1.0 - f[1]) + (s111 - s110) * f[1]
    gradient = Vec3(
        b1 - b0,
        (a01 - a00) * (1.0 - f[0]) + (a11 - a10) * f[0],
        z0 * (1.0 - f[0]) + z1 * f[0],
    )
    length = ti.sqrt(gradient.dot(gradient))
    return b0 + (b1 - b0) * f[0], gradient / ti.max(length, 1e-9)


@ti.func
def sdf_distance(local, sdf: ti.template(), contact: ti.template()):
    """The distance of `sdf_sample` alone: less to compile, where no gradient is needed."""
    u = (local - contact.sdf_origin) / contact.sdf_spacing
    low = Int3(0, 0, 0)
    for d in ti.static(range(3)):
        low[d] = ti.max(0, ti.min(ti.cast(u[d], ti.i32), contact.sdf_shape[d] - 2))
    f = u - ti.cast(low, ti.f32)
    ny, nz = contact.sdf_shape[1], contact.sdf_shape[2]
    total = 0.0
    for p in range(2):
        for q in range(2):
            at = ((low[0] + p) * ny + low[1] + q) * nz + low[2]
            w = ti.select(p == 1, f[0], 1.0 - f[0]) * ti.select(q == 1, f[1], 1.0 - f[1])
            total = total + w * (sdf[at] + (sdf[at + 1] - sdf[at]) * f[2])
    return total


@ti.func
def coulomb(velocity, wall, normal, friction):
    """Velocity [m/s] after contact: no inward normal part, tangential part slowed by friction."""
    relative = velocity - wall
    inward = relative.dot(normal)
    result = velocity
    if inward < 0.0:
        tangential = relative - inward * normal
        speed = ti.sqrt(tangential.dot(tangential))
        keep = ti.select(speed > 1e-12, ti.max(0.0, 1.0 + friction * inward / speed), 0.0)
        result = wall + keep * tangential
    return result


@ti.func
def finger_share(local, distance, sdf: ti.template(), grid: ti.template(), contact: ti.template()):
    """Share of a node's cell that a finger takes: eight samples, each half a cell wide."""
    share = 0.0
    if distance < -CELL * grid.dx:
        share = 1.0
    elif distance < CELL * grid.dx:
        for o in range(8):
            corner = local + (Vec3(o // 4, (o // 2) % 2, o % 2) - 0.5) * (0.5 * grid.dx)
            d = sdf_distance(corner, sdf, contact)
            share = share + 0.125 * ti.max(0.0, ti.min(1.0, 0.5 - 2.0 * d / grid.dx))
    return share


@ti.func
def find_fingers(
    low,
    high,
    opening,
    sdf: ti.template(),
    colliders: ti.template(),
    free: ti.template(),
    grid: ti.template(),
    contact: ti.template(),
):
    """Distance and normal of both fingers at the nodes, and the volume they leave free there.

    Loops are nested, because Taichi makes of `ti.ndrange` four divisions a node.
    """
    ny, nz = grid.shape[1], grid.shape[2]
    total = grid.shape[0] * ny * nz
    first, last = high, low  # box of the nodes that a finger takes volume from
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                at = (i * ny + j) * nz + k
                node = grid.origin + grid.dx * Vec3(i, j, k)
                occupied = 0.0
                for finger in range(2):
                    local = finger_local(node, finger, opening, contact)
                    found = Vec4(0.0, 0.0, 0.0, FAR)
                    if sdf_near(local, 0.5 * grid.dx, grid.dx, contact):
                        distance, gradient = sdf_sample(local, sdf, contact)
                        n = finger_world(gradient, finger, contact)
                        found = Vec4(n[0], n[1], n[2], distance)
                        occupied = occupied + finger_share(local, distance, sdf, grid, contact)
                    colliders[finger * total + at] = found
                free[at] = ti.max(0.0, 1.0 - occupied)
                free[total + at] = 1.0
                if occupied > 0.0:
                    first = ti.min(first, Int3(i, j, k))
                    last = ti.max(last, Int3(i, j, k) + 1)
    begin, end = ti.max(low, first - 1), ti.min(high, last + 1)
    for d in range(3):  # B-spline taps along one axis after the other, from one half to the other
        source, target = (d % 2) * total, (1 - d % 2) * total
        stride = ti.select(d == 0, ny * nz, ti.select(d == 1, nz, 1))
        for i in range(begin[0], end[0]):
            for j in range(begin[1], end[1]):
                for k in range(begin[2], end[2]):
                    at = (i * ny + j) * nz + k
                    index = ti.select(d == 0, i, ti.select(d == 1, j, k))
                    start = ti.select(d == 0, low[0], ti.select(d == 1, low[1], low[2]))
                    stop = ti.select(d == 0, high[0], ti.select(d == 1, high[1], high[2]))
                    value = free[source + at]
                    if index > start and index < stop - 1:
                        beside = free[source + at - stride] + free[source + at + stride]
                        value = 0.75 * value + 0.125 * beside
                    free[target + at] = value


@ti.func
def find_touch(
    low,
    high,
    opening,
    x: ti.template(),
    sdf: ti.template(),
    touch: ti.template(),
    grid: ti.template(),
    contact: ti.template(),
):
    """Which walls the dough around each node touches: 1 and 2 the fingers, 4 the table, added up.

    A node moves dough that is up to 1.5 cells away. Stopped by a wall regardless, it would hold
    dough in the air: dropped from one cell, a block came to rest 0.85 cells above the table.
    """
    ny, nz = grid.shape[1], grid.shape[2]
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for at in range((i * ny + j) * nz + low[2], (i * ny + j) * nz + high[2]):
                touch[at] = 0
    for i in range(x.shape[0]):
        place = Vec3(x[i][0], x[i][1], x[i][2])
        walls = ti.select(grid.table >= 0 and place[2] <= contact.reach, 4, 0)
        for finger in range(contact.fingers):
            local = finger_local(place, finger, opening, contact)
            if sdf_near(local, 0.0, contact.reach, contact):
                distance = sdf_distance(local, sdf, contact)
                if distance <= contact.reach:
                    walls = walls | (1 << finger)
        if walls > 0:
            base = ti.cast((place - grid.origin) * grid.inverse - 0.5, ti.i32)
            for p in range(3):
                for q in range(3):
                    row = ((base[0] + p) * ny + base[1] + q) * nz + base[2]
                    for at in range(row, row + 3):
                        touch[at] = touch[at] | walls
