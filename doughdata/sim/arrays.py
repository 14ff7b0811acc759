"""Types of the arrays that kernels take: flat numpy arrays of numbers, vectors or matrices."""

from doughdata.sim._taichi import ti
from doughdata.sim.contact import Vec4
from doughdata.sim.stress import Mat3, Sym, Vec3

__all__ = [
    "Counts",
    "Integers",
    "Matrices",
    "Nodes",
    "Numbers",
    "Scalars",
    "Symmetrics",
    "Vectors",
]

Scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
Vectors = ti.types.ndarray(dtype=Vec3, ndim=1)
Matrices = ti.types.ndarray(dtype=Mat3, ndim=1)
Symmetrics = ti.types.ndarray(dtype=Sym, ndim=1)
Nodes = ti.types.ndarray(dtype=Vec4, ndim=1)
Numbers = ti.types.ndarray(dtype=ti.f32, ndim=2)  # a row a cloud
Counts = ti.types.ndarray(dtype=ti.i32, ndim=2)  # a row a cloud
