"""Every Taichi function of the stress update, judged by numpy's eigenvalues in double precision."""

import numpy as np
import pytest

from doughdata.sim import stress
from doughdata.sim._taichi import start, ti

start("cpu")
SHEAR, BULK = 17_857.0, 83_333.0
COUNT = 400
Symmetrics = ti.types.ndarray(dtype=stress.Sym, ndim=1)
Vectors = ti.types.ndarray(dtype=stress.Vec3, ndim=1)
Matrices = ti.types.ndarray(dtype=stress.Mat3, ndim=1)
Scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def run_algebra(s: Symmetrics, square: Symmetrics, det: Scalars, norm2: Scalars):
    for i in range(s.shape[0]):
        square[i] = stress.sym_square(s[i])
        det[i] = stress.sym_det(s[i])
        norm2[i] = stress.sym_norm2(s[i])


@ti.kernel
def run_eigen(s: Symmetrics, values: Vectors, axes: Matrices, rebuilt: Symmetrics):
    for i in range(s.shape[0]):
        w, q = stress.sym_eigen(s[i])
        values[i] = w
        axes[i] = q
        rebuilt[i] = stress.sym_rebuild(w, q)


@ti.kernel
def run_log(s: Symmetrics, deviator: Symmetrics, det: Scalars):
    for i in range(s.shape[0]):
        dev_i, det_i = stress.sym_log(s[i])
        deviator[i] = dev_i
        det[i] = det_i


@ti.kernel
def run_exp(x: Symmetrics, result: Symmetrics):
    for i in range(x.shape[0]):
        result[i] = stress.sym_exp_deviator(x[i])


@ti.kernel
def run_return(
    s: Symmetrics, b: Symmetrics, tau: Symmetrics, yield_strain: ti.f32, largest: ti.f32
):
    for i in range(s.shape[0]):
        b_i, tau_i = stress.hencky_return(s[i], SHEAR, BULK, yield_strain, largest)
        b[i] = b_i
        tau[i] = tau_i


def pack(m: np.ndarray) -> np.ndarray:
    """(n, 3, 3) -> (n, 6) as xx, yy, zz, xy, yz, xz."""
    rows, columns = [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]
    return np.ascontiguousarray(m[:, rows, columns], dtype=np.float32)


def unpack(s: np.ndarray) -> np.ndarray:
    """(n, 6) -> (n, 3, 3) in double precision."""
    return s.astype(np.float64)[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)


def random_symmetric(size: float, *, seed: int, count: int = COUNT) -> np.ndarray:
    """Random symmetric matrices of a Frobenius norm up to `size`, some of them diagonal or zero."""
    rng = np.random.default_rng(seed)
    m = rng.normal(size=(count, 3, 3))
    m = m + m.transpose(0, 2, 1)
    m *= size * rng.random((count, 1, 1)) / np.linalg.norm(m, axis=(1, 2), keepdims=True)
    m[0] = 0.0
    m[1] = np.diag([size, -size / 2, -size / 2]) / 1.3
    return m


def apply(m: np.ndarray, function) -> np.ndarray:
    """A scalar function of symmetric matrices, through their eigenvalues."""
    values, axes = np.linalg.eigh(m)
    return np.einsum("nij,nj,nkj->nik", axes, function(values), axes)


def deviator(m: np.ndarray) -> np.ndarray:
    """m - tr(m) I / 3."""
    return m - np.trace(m, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3


def empty(*shape: int) -> np.ndarray:
    return np.zeros((COUNT, *shape), np.float32)


def test_square_determinant_and_norm() -> None:
    """The packed square, determinant and norm are those of the full matrix."""
    m = random_symmetric(2.0, seed=0)
    square, det, norm2 = empty(6), empty(), empty()
    run_algebra(pack(m), square, det, norm2)
    assert np.abs(unpack(square) - m @ m).max() < 2e-6
    assert np.abs(det - np.linalg.det(m)).max() < 2e-6
    assert np.abs(norm2 - (m**2).sum((1, 2))).max() < 2e-6


def test_eigenvalues_and_axes() -> None:
    """Jacobi's eigenvalues are LAPACK's, the axes are orthonormal and rebuild the matrix."""
    m = random_symmetric(3.0, seed=1)
    values, axes, rebuilt = empty(3), empty(3, 3), empty(6)
    run_eigen(pack(m), values, axes, rebuilt)
    assert np.abs(np.sort(values, axis=1) - np.linalg.eigvalsh(m)).max() < 5e-6
    assert np.abs(axes @ axes.transpose(0, 2, 1) - np.eye(3)).max() < 5e-6
    assert np.abs(unpack(rebuilt) - m).max() < 5e-6


@pytest.mark.parametrize("size", [0.02, 0.2, 0.8, 4.0])
def test_logarithm(size: float) -> None:
    """Deviator and determinant match the eigenvalue method, in the series and beyond."""
    strain = random_symmetric(size, seed=2)
    s = pack(apply(strain, np.exp))
    got, det = empty(6), empty()
    run_log(s, got, det)
    exact = apply(unpack(s), np.log)
    # Single precision leaves the smallest eigenvalue with an error of eps times the largest.
    tolerance = 3e-6 * np.exp(2 * size)
    assert np.abs(unpack(got) - deviator(exact)).max() < tolerance
    assert np.abs(np.log(det) - np.trace(exact, axis1=1, axis2=2)).max() < tolerance


@pytest.mark.parametrize("size", [0.1, 0.9, 6.0])
def test_exponential(size: float) -> None:
    """The exponential of a deviator matches the eigenvalue method to single precision."""
    x = deviator(random_symmetric(size, seed=3))
    got = empty(6)
    run_exp(pack(x), got)
    exact = apply(x, np.exp)
    scale = np.linalg.norm(exact, axis=(1, 2)).max()
    assert np.abs(unpack(got) - exact).max() < 1e-5 * scale


@pytest.mark.parametrize(
    ("size", "yield_strain"), [(0.05, 0.046), (0.5, 0.046), (0.5, 0.4), (0.8, 1e9)]
)
def test_return_mapping(size: float, yield_strain: float) -> None:
    """Stress and strain after yield are those of radial return in logarithmic strain."""
    s = pack(apply(random_symmetric(size, seed=4), np.exp))
    b, tau = empty(6), empty(6)
    run_return(s, b, tau, yield_strain, 1e6)
    strain = 0.5 * apply(unpack(s), np.log)
    dev, trace = deviator(strain), np.trace(strain, axis1=1, axis2=2)
    size_dev = np.linalg.norm(dev, axis=(1, 2))
    dev = dev * np.minimum(1.0, yield_strain / np.maximum(size_dev, 1e-12))[:, None, None]
    volumetric = trace[:, None, None] * np.eye(3)
    exact_tau = 2 * SHEAR * dev + BULK * volumetric
    exact_b = apply(2 * dev + 2 * volumetric / 3, np.exp)
    assert np.abs(unpack(tau) - exact_tau).max() < 2e-5 * BULK
    assert np.abs(unpack(b) - exact_b).max() < 2e-5


def test_yield_cap() -> None:
    """Von Mises stress never passes the yield stress by more than 1e-4 of it."""
    yield_stress = 2_000.0
    yield_strain = np.sqrt(2 / 3) * yield_stress / (2 * SHEAR)
    s = pack(apply(random_symmetric(1.0, seed=5), np.exp))
    b, tau = empty(6), empty(6)
    run_return(s, b, tau, yield_strain, 1e6)
    mises = np.sqrt(1.5) * np.linalg.norm(deviator(unpack(tau)), axis=(1, 2))
    assert mises.max() <= yield_stress * (1 + 1e-4)
    assert mises.max() > 0.99 * yield_stress
    after = (
        np.sqrt(1.5)
        * 2
        * SHEAR
        * np.linalg.norm(deviator(0.5 * apply(unpack(b), np.log)), axis=(1, 2))
    )
    assert after.max() <= yield_stress * (1 + 1e-3)


def test_plastic_return_keeps_volume() -> None:
    """Yield leaves det b unchanged to 1e-5."""
    s = pack(apply(random_symmetric(0.6, seed=6), np.exp))
    b, tau = empty(6), empty(6)
    run_return(s, b, tau, 0.046, 1e6)
    ratio = np.linalg.det(unpack(b)) / np.linalg.det(unpack(s))
    assert np.abs(ratio - 1).max() < 1e-5


def test_volume_cap() -> None:
    """J never passes the given cap, and is left alone below it."""
    s = pack(apply(random_symmetric(0.6, seed=7), np.exp))
    b, tau = empty(6), empty(6)
    run_return(s, b, tau, 0.046, 0.9)
    before, after = (np.sqrt(np.linalg.det(unpack(a))) for a in (s, b))
    assert np.abs(after - np.minimum(before, 0.9)).max() < 1e-5
