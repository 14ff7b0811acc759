"""Speed of the simulator: against a textbook Taichi kernel, and in seconds a scene.

    python benchmarks/simulation.py --json

Both kernels move the same block (16,384 particles, 8 a cell) under gravity on a table, with the
same material and substep, in grids of 64 and 128 cells a side. The textbook kernel is what the
Taichi examples do: deformation gradient, `ti.svd`, atomic scatter, the whole grid every substep,
Taichi's default options. Each measurement runs in a process of its own, because Taichi starts once
a process. One-core figures are of CPU time, two-core figures of wall time (they need two idle
cores), best of three runs or more in six seconds; `compile_s` is the wall time of a first substep
without any cache. `scene_cpu_s` is of a process's second scene, as nearly all scenes of a dataset
are; `scene_first_cpu_s` is of its first, compilation included.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any

import numpy as np

from doughdata.sim.kernel_cache import VARIABLE
from doughschemas import Action, Body, Material, Scene

SPACING, DT, STEPS = 0.00125, 1e-4, 200
REPEATS, LEAST = 3, 6.0  # runs, seconds of them
GRIDS = (64, 128)
DX, FLOOR = 2 * SPACING, 3
MATERIAL = Material(poisson_ratio=0.35, density=1200.0, yield_stress=1500.0)
SHEAR = MATERIAL.young_modulus / (2 * (1 + MATERIAL.poisson_ratio))
BULK = MATERIAL.young_modulus / (3 * (1 - 2 * MATERIAL.poisson_ratio))
YIELD = float(np.sqrt(2 / 3)) * MATERIAL.yield_stress / (2 * SHEAR)


def block() -> np.ndarray:
    """A 40 x 40 x 20 mm block on the table, particles in no order: [m], (16384, 3)."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in (32, 32, 16)], indexing="ij"), -1)
    points = (grid.reshape(-1, 3) + 0.5 + rng.uniform(-0.3, 0.3, (16384, 3))) * SPACING
    return rng.permutation(points - [16 * SPACING, 16 * SPACING, 0.0])


def best_mpps(run: Any, threads: int) -> float:
    """Million particle-substeps a second (CPU time of one thread, wall time of more)."""
    clock = time.process_time if threads == 1 else time.perf_counter
    times: list[float] = []
    while len(times) < REPEATS or sum(times) < LEAST:
        begin = clock()
        run()
        times.append(clock() - begin)
    return 16384 * STEPS / min(times) / 1e6


def measure_textbook(nodes: int, threads: int) -> dict[str, float]:
    """The baseline, in a domain of `nodes` cells a side with the table at cell 3."""
    import taichi as ti

    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, offline_cache=False, log_level=ti.ERROR)
    count, volume = 16384, SPACING**3
    mass = volume * MATERIAL.density
    x, v = ti.Vector.field(3, ti.f32, count), ti.Vector.field(3, ti.f32, count)
    C, F = ti.Matrix.field(3, 3, ti.f32, count), ti.Matrix.field(3, 3, ti.f32, count)
    grid_v = ti.Vector.field(3, ti.f32, (nodes, nodes, nodes))
    grid_m = ti.field(ti.f32, (nodes, nodes, nodes))

    @ti.kernel
    def substep():
        for node in ti.grouped(grid_m):
            grid_v[node] = ti.Vector.zero(ti.f32, 3)
            grid_m[node] = 0.0
        for p in x:
            base = (x[p] / DX - 0.5).cast(int)
            fx = x[p] / DX - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            U, sig, V = ti.svd((ti.Matrix.identity(ti.f32, 3) + DT * C[p]) @ F[p])
            strain = ti.Vector([ti.log(sig[0, 0]), ti.log(sig[1, 1]), ti.log(sig[2, 2])])
            trace = strain.sum()
            deviator = strain - trace / 3
            size = deviator.norm() + 1e-12
            kept = deviator * ti.min(1.0, YIELD / size)
            stretch, tau = ti.Matrix.zero(ti.f32, 3, 3), ti.Matrix.zero(ti.f32, 3, 3)
            for d in ti.static(range(3)):
                stretch[d, d] = ti.exp(kept[d] + trace / 3)
                tau[d, d] = 2 * SHEAR * kept[d] + BULK * trace
            F[p] = U @ stretch @ V.transpose()
            affine = (-DT * volume * 4 / DX**2) * (U @ tau @ U.transpose()) + mass * C[p]
            for offset in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                weight = w[offset[0]][0] * w[offset[1]][1] * w[offset[2]][2]
                dpos = (offset - fx) * DX
                grid_v[base + offset] += weight * (mass * v[p] + affine @ dpos)
                grid_m[base + offset] += weight * mass
        for node in ti.grouped(grid_m):
            if grid_m[node] > 0:
                velocity = grid_v[node] / grid_m[node] - ti.Vector([0.0, 0.0, 9.81 * DT])
                if node[2] <= FLOOR and velocity[2] < 0:
                    speed = ti.sqrt(velocity[0] ** 2 + velocity[1] ** 2) + 1e-12
                    keep = ti.max(0.0, 1 + 0.5 * velocity[2] / speed)
                    velocity = ti.Vector([velocity[0] * keep, velocity[1] * keep, 0.0])
                grid_v[node] = velocity
        for p in x:
            base = (x[p] / DX - 0.5).cast(int)
            fx = x[p] / DX - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v, new_C = ti.Vector.zero(ti.f32, 3), ti.Matrix.zero(ti.f32, 3, 3)
            for offset in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                weight = w[offset[0]][0] * w[offset[1]][1] * w[offset[2]][2]
                g = grid_v[base + offset]
                new_v += weight * g
                new_C += 4 * weight * g.outer_product(offset - fx) / DX
            v[p], C[p] = new_v, new_C
            x[p] += DT * new_v

    shift = np.array([nodes / 2, nodes / 2, FLOOR]) * DX

    def run() -> None:
        x.from_numpy((block() + shift).astype(np.float32))
        v.fill(0)
        C.fill(0)
        F.from_numpy(np.tile(np.eye(3, dtype=np.float32), (count, 1, 1)))
        for _ in range(STEPS):
            substep()
        ti.sync()

    substep()
    mpps = best_mpps(run, threads)
    return {"mpps": mpps, "height": float((x.to_numpy() - shift)[:, 2].mean())}


def measure_ours(nodes: int, threads: int) -> dict[str, float]:
    """The project's kernels on the same block, in a domain of the same size."""
    from doughdata.sim.solver import Physics, Solver

    half = nodes / 2 * DX
    physics = Physics(
        material=MATERIAL,
        spacing=SPACING,
        dx=DX,
        cfl=0.5,
        density_cap=1.15,
        gravity=9.81,
        low=(-half, -half, 0.0),
        high=(half, half, 2 * half),
        table_friction=0.5,
    )
    begin = time.perf_counter()
    solver = Solver(block(), physics, threads=threads)
    solver.advance(DT, steps=1)
    compiled = time.perf_counter() - begin

    def run() -> None:
        nonlocal solver
        solver = Solver(block(), physics, threads=threads)
        solver.advance(STEPS * DT, steps=STEPS)

    mpps = best_mpps(run, threads)
    return {"mpps": mpps, "height": float(solver.x[:, 2].mean()), "compile_s": compiled}


def measure_scene() -> dict[str, float]:
    """The default doughnut, regular tool, 100 -> 1 mm, 75 key frames, 2 mm particles."""
    from doughdata.scenes import PRESETS
    from doughdata.sim.mpm import MpmSimulator

    scene = Scene(
        scene_id="benchmark",
        family="doughnut",
        bodies=(Body(shape="ring"),),
        tools=(PRESETS["regular"],),
        actions=(Action(),),
    )
    taken = []
    for _ in range(2):
        begin = time.process_time()
        particles = MpmSimulator().simulate(scene, rng=np.random.default_rng(0))
        taken.append(time.process_time() - begin)
    count = particles.positions.shape[1]
    return {"first_cpu_s": taken[0], "cpu_s": taken[1], "particles": count}


def measure_apart(what: str, nodes: int, threads: int) -> dict[str, float]:
    """One measurement of a block, in a process of its own."""
    command = [sys.executable, __file__, "--only", what, str(nodes), str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def measure() -> dict[str, float]:
    """All figures of this file."""
    os.environ[VARIABLE] = "off"  # no kernel that another process has compiled
    result: dict[str, float] = {}
    for threads, cores in ((1, "1core"), (2, "2core")):
        for nodes in GRIDS:
            ours = measure_apart("ours", nodes, threads)
            textbook = measure_apart("textbook", nodes, threads)
            key = f"{cores}_{nodes}"
            result[f"speedup_{key}"] = round(ours["mpps"] / textbook["mpps"], 2)
            result[f"mpps_{key}"] = round(ours["mpps"], 3)
            result[f"textbook_mpps_{key}"] = round(textbook["mpps"], 3)
            result[f"height_difference_um_{key}"] = round(
                1e6 * abs(ours["height"] - textbook["height"]), 2
            )
            if threads == 1 and nodes == GRIDS[0]:
                result["compile_s"] = round(ours["compile_s"], 2)
        for name in ("speedup", "mpps", "textbook_mpps"):
            result[f"{name}_{cores}"] = min(result[f"{name}_{cores}_{nodes}"] for nodes in GRIDS)
    scene = measure_scene()
    result["scene_cpu_s"] = round(scene["cpu_s"], 2)
    result["scene_first_cpu_s"] = round(scene["first_cpu_s"], 2)
    result["scene_particles"] = scene["particles"]
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on one line")
    parser.add_argument("--only", nargs=3, metavar=("WHAT", "NODES", "THREADS"))
    arguments = parser.parse_args()
    if arguments.only:
        one = measure_ours if arguments.only[0] == "ours" else measure_textbook
        print(json.dumps(one(int(arguments.only[1]), int(arguments.only[2]))))
    elif arguments.json:
        print(json.dumps(measure()))
    else:
        for name, value in measure().items():
            print(f"{name:28s} {value}")
