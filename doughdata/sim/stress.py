"""Hencky elasticity with von Mises yield, without a singular-value decomposition.

State per particle: b = F F^T, symmetric, packed as (xx, yy, zz, xy, yz, xz). Symmetric matrices
obey their own characteristic equation (Cayley-Hamilton), so the logarithm and the exponential of a
deviator are three scalars times I, X and X^2. Far from the identity Jacobi's eigenvalue method
takes over. Taichi 1.7.4 loses an in-place update that follows a conditional one: names are never
updated in place here.
"""

# Taichi annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

from math import factorial

from doughdata.sim._taichi import ti

__all__ = [
    "Sym",
    "hencky_return",
    "sym_det",
    "sym_eigen",
    "sym_exp_deviator",
    "sym_log",
    "sym_square",
]

Sym = ti.types.vector(6, ti.f32)
Vec3 = ti.types.vector(3, ti.f32)
Mat3 = ti.types.matrix(3, 3, ti.f32)

# Coefficients of both series, which go to order 8.
THIRD, SEVENTH = 1.0 / 3.0, 1.0 / 7.0
C3, C4, C5, C6, C7, C8 = (1.0 / factorial(k) for k in range(3, 9))
SERIES_LOG = 0.0625  # |Y|^2 up to which log(I + Y) is a series: truncation below 1e-6 at |Y| = 0.25
SERIES_EXP = 1.0  # |X|^2 up to which exp(X) is a series: truncation below 3e-6 at |X| = 1
SMALLEST = 1e-8  # eigenvalues of b are kept above


@ti.func
def sym_square(s):
    """S S of a packed symmetric matrix."""
    return Sym(
        s[0] * s[0] + s[3] * s[3] + s[5] * s[5],
        s[3] * s[3] + s[1] * s[1] + s[4] * s[4],
        s[5] * s[5] + s[4] * s[4] + s[2] * s[2],
        s[0] * s[3] + s[3] * s[1] + s[5] * s[4],
        s[3] * s[5] + s[1] * s[4] + s[4] * s[2],
        s[0] * s[5] + s[3] * s[4] + s[5] * s[2],
    )


@ti.func
def sym_det(s):
    """Determinant of a packed symmetric matrix."""
    return (
        s[0] * (s[1] * s[2] - s[4] * s[4])
        + s[3] * (s[4] * s[5] - s[3] * s[2])
        + s[5] * (s[3] * s[4] - s[1] * s[5])
    )


@ti.func
def sym_norm2(s):
    """Squared Frobenius norm of a packed symmetric matrix."""
    return s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + 2.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5])


@ti.func
def sym_eigen(s):
    """Eigenvalues and eigenvectors (columns) of a packed symmetric matrix, by Jacobi rotations."""
    a = Mat3(s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2])
    q = Mat3(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    for _ in range(6):  # quadratic convergence: 1e-7 is reached after four sweeps
        for axes in ti.static(((0, 1, 2), (0, 2, 1), (1, 2, 0))):
            i, j, k = ti.static(axes[0], axes[1], axes[2])
            off = a[i, j]
            if ti.abs(off) > 1e-12 * (ti.abs(a[i, i]) + ti.abs(a[j, j])):
                theta = (a[j, j] - a[i, i]) / (2.0 * off)
                side = ti.select(theta >= 0.0, 1.0, -1.0)
                t = side / (ti.abs(theta) + ti.sqrt(theta * theta + 1.0))
                c = 1.0 / ti.sqrt(t * t + 1.0)
                s_ik, s_jk = c * a[i, k] - t * c * a[j, k], t * c * a[i, k] + c * a[j, k]
                a[i, i] = a[i, i] - t * off
                a[j, j] = a[j, j] + t * off
                a[i, j], a[j, i] = 0.0, 0.0
                a[i, k], a[k, i] = s_ik, s_ik
                a[j, k], a[k, j] = s_jk, s_jk
                for d in ti.static(range(3)):
                    q_i, q_j = c * q[d, i] - t * c * q[d, j], t * c * q[d, i] + c * q[d, j]
                    q[d, i] = q_i
                    q[d, j] = q_j
    return Vec3(a[0, 0], a[1, 1], a[2, 2]), q


@ti.func
def sym_rebuild(values, q):
    """Packed Q diag(values) Q^T."""
    m = q @ Mat3(values[0], 0.0, 0.0, 0.0, values[1], 0.0, 0.0, 0.0, values[2]) @ q.transpose()
    return Sym(m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[1, 2], m[0, 2])


@ti.func
def sym_log(s):
    """Deviator of log(S) and det S of a packed positive matrix S.

    S = m (I + Y) with m = tr(S)/3, so tr Y = 0 and Y^3 = p Y + q I, p = tr(Y^2)/2, q = det Y.
    """
    m = (s[0] + s[1] + s[2]) / 3.0
    y = (1.0 / m) * s - Sym(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    deviator = Sym(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    det = 1.0
    if m > SMALLEST and sym_norm2(y) < SERIES_LOG:
        y2 = sym_square(y)
        p = 0.5 * (y2[0] + y2[1] + y2[2])
        q = sym_det(y)
        pp, pq = p * p, p * q
        last = pp * p + q * q
        # Y^3 .. Y^8 in I, Y, Y^2, summed with 1, -1/2, 1/3 ..; the trace is taken off below
        f1 = 1.0 + THIRD * (p - pq) - 0.25 * q + 0.2 * pp + SEVENTH * last - 0.375 * pp * q
        f2 = -0.5 - 0.25 * p + 0.2 * q - 0.5 * THIRD * pp + 2.0 * SEVENTH * pq - 0.125 * last
        mean = f2 * p * (2.0 / 3.0)
        deviator = f1 * y + f2 * y2 - Sym(mean, mean, mean, 0.0, 0.0, 0.0)
        det = m * m * m * (1.0 - p + q)
    else:
        values, axes = sym_eigen(s)
        kept = ti.max(values, SMALLEST)
        logs = ti.log(kept)
        det = kept[0] * kept[1] * kept[2]
        deviator = sym_rebuild(logs - (logs[0] + logs[1] + logs[2]) / 3.0, axes)
    return deviator, det


@ti.func
def sym_exp_deviator(x):
    """exp(X) of a packed symmetric matrix without trace; X is halved until the series holds."""
    halvings = 0
    scale = 1.0
    size2 = sym_norm2(x)
    while size2 * scale * scale > SERIES_EXP and halvings < 20:
        scale = 0.5 * scale
        halvings = halvings + 1
    y = scale * x
    y2 = sym_square(y)
    p = 0.5 * (y2[0] + y2[1] + y2[2])
    q = sym_det(y)
    pp, pq, qq = p * p, p * q, q * q
    last = pp * p + qq
    # Y^3 .. Y^8 in I, Y, Y^2, divided by 3! .. 8!
    f0 = 1.0 + C3 * q + C5 * pq + C6 * qq + C7 * pp * q + 2.0 * C8 * pq * q
    f1 = 1.0 + C3 * p + C4 * q + C5 * pp + 2.0 * C6 * pq + C7 * last + 3.0 * C8 * pp * q
    f2 = 0.5 + C4 * p + C5 * q + C6 * pp + 2.0 * C7 * pq + C8 * last
    result = f1 * y + f2 * y2 + Sym(f0, f0, f0, 0.0, 0.0, 0.0)
    for _ in range(halvings):
        squared = sym_square(result)
        result = squared
    return result


@ti.func
def hencky_return(trial, shear, bulk, yield_strain, largest_volume):
    """Return mapping: b after yield and the Kirchhoff stress [Pa], both packed.

    Hencky energy: tau = 2 mu dev(e) + K tr(e) I with e = log(b)/2. The deviator is limited to
    `yield_strain` = sqrt(2/3) sigma_y / (2 mu) (von Mises), which leaves det b as it is. J =
    sqrt(det b) is limited to `largest_volume`, and b is scaled to match.
    """
    doubled, det = sym_log(trial)
    strain = 0.5 * doubled
    size2 = sym_norm2(strain)
    limit = largest_volume * largest_volume
    b = trial
    if det > limit:
        b = ti.exp(ti.log(limit / det) / 3.0) * trial
    log_det = ti.log(ti.min(det, limit))
    shrink = 1.0
    if size2 > yield_strain * yield_strain:
        shrink = yield_strain / ti.sqrt(size2)
        b = ti.exp(log_det / 3.0) * sym_exp_deviator((2.0 * shrink) * strain)
    pressure = 0.5 * bulk * log_det
    tau = (2.0 * shear * shrink) * strain + Sym(pressure, pressure, pressure, 0.0, 0.0, 0.0)
    return b, tau
