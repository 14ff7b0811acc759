"""Many clouds moved together: one launch advances all of them by a substep.

Made for a GPU, which a single scene of some thousand particles leaves idle; it runs on the CPU as
well. Sums are atomic, so two runs agree to rounding, not to the bit. A cloud needs 180 bytes a
particle, 60 bytes a node of its active box (not of its domain), and each finger's distance grid.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from doughdata.scenes.sdf import SignedDistanceGrid
from doughdata.sim import gpu_kernels, gpu_rows
from doughdata.sim._taichi import start, ti
from doughdata.sim.kernels import EVERY
from doughdata.sim.script import Stretch
from doughdata.sim.solver import RETRIES, Solver, contact_of, grid_of
from doughdata.sim.transfers import CFL_BROKEN
from doughschemas import BadInputError, SimulationError

__all__ = ["BatchSolver"]

SPARE = 1.3  # node arrays are this much larger than what is asked for when they are made


class BatchSolver:
    """Moves several clouds at once; each keeps its own material, domain, fingers and time step.

    `clouds[k].x`, `.v` and `.b` are up to date after every call, all else after `download`. A cloud
    that fails is frozen, and `errors[k]` says why; the others go on.

    Args:
        clouds: without handles. No other arch may be started while the batch is in use.
        arch: see `doughdata.sim._taichi.start`.
        threads: of the CPU.

    Raises:
        BadInputError: no cloud, one with handles, or an arch that this machine has not.
    """

    def __init__(self, clouds: Sequence[Solver], *, arch: str = "cpu", threads: int = 1) -> None:
        if not clouds or any(cloud.handles.any() for cloud in clouds):
            raise BadInputError("a batch needs clouds, and clouds without handles: use Solver")
        start(arch, threads=threads)
        self.clouds = list(clouds)
        self.errors: list[SimulationError | None] = [None] * len(clouds)
        self._first = np.cumsum([0, *(len(cloud.x) for cloud in clouds)])
        count, rows = int(self._first[-1]), len(clouds)
        self._x, self._v, self._C, self._b, self._largest = self._particle_arrays(count)
        self._cloud = ti.ndarray(ti.i32, count)
        self._numbers = ti.ndarray(ti.f32, (rows, len(gpu_rows.NUMBERS)))
        self._counts = ti.ndarray(ti.i32, (rows, len(gpu_rows.COUNTS)))
        self._state = ti.ndarray(ti.i32, (rows, gpu_rows.STATE))
        self._used = ti.ndarray(ti.i32, 2)
        self._again = ti.ndarray(ti.i32, rows)
        self._before = self._particle_arrays(count)
        self._cloud.from_numpy(np.repeat(np.arange(rows, dtype=np.int32), np.diff(self._first)))
        self._sdf, self._sdf_first = ti.ndarray(ti.f32, 8), {}
        self._fingers: list[SignedDistanceGrid] = []
        self._make_nodes(1)
        self.upload()

    def upload(self) -> None:
        """Take over what the clouds' arrays hold."""
        for name, array in self._arrays().items():
            array.from_numpy(np.concatenate([getattr(cloud, name) for cloud in self.clouds]))

    def download(self) -> None:
        """Bring all arrays of the clouds up to date."""
        self._fetch(tuple(self._arrays()))

    def advance(self, stretches: Sequence[Stretch | None]) -> list[int]:
        """Move cloud k by `stretches[k]` and return how many substeps each made; None: it rests.

        A cloud that fails during the call stays as it was then, and gets its entry in `errors`.

        Raises:
            BadInputError: not one stretch a cloud.
        """
        if len(stretches) != len(self.clouds):
            raise BadInputError(f"expected {len(self.clouds)} stretches, got {len(stretches)}")
        steps = np.zeros(len(stretches), np.int64)
        for k, stretch in enumerate(stretches):
            if stretch is not None and self.errors[k] is None:
                steps[k] = stretch.steps or self.clouds[k].substeps(
                    stretch.seconds, squeeze=stretch.squeeze
                )
        self._load_fingers(stretches)
        self._keep()
        done, failed = self._attempt(stretches, steps)
        for _ in range(RETRIES):
            again = [
                k
                for k, (status, _) in failed.items()
                if status == CFL_BROKEN and (s := stretches[k]) is not None and not s.steps
            ]
            if not again:
                break
            self._take_back(again)
            more = np.zeros_like(steps)
            more[again] = steps[again] = 2 * steps[again]
            redone, failed_again = self._attempt(stretches, more)
            done[again] = redone[again]
            failed = {k: why for k, why in failed.items() if k not in again} | failed_again
        self._fetch(("x", "v", "b"))
        for k, reason in failed.items():
            self.errors[k] = self._error(k, *reason)
        return done.tolist()

    def _attempt(
        self, stretches: Sequence[Stretch | None], steps: np.ndarray
    ) -> tuple[np.ndarray, dict[int, tuple[int, int]]]:
        """Make the given numbers of substeps: how many were made, and why clouds failed."""
        numbers, counts = self._numbers.to_numpy(), self._counts.to_numpy()
        for k, stretch in enumerate(stretches):
            if stretch is not None and steps[k]:
                numbers[k], counts[k] = self._rows(self.clouds[k], stretch, int(steps[k]))
        self._numbers.from_numpy(numbers)
        left, done = steps.copy(), np.zeros_like(steps)
        failed: dict[int, tuple[int, int]] = {}
        while left.any():
            counts[:, gpu_rows.COUNTS.index("done")] = done
            self._counts.from_numpy(counts)
            state = self._launch(left)
            done += state[:, gpu_rows.LIMIT]
            left -= state[:, gpu_rows.LIMIT]
            for k in np.flatnonzero(state[:, gpu_rows.STATUS]):
                left[k] = 0
                failed[int(k)] = int(state[k, gpu_rows.STATUS]), int(state[k, gpu_rows.DETAIL])
        return done, failed

    def _keep(self) -> None:
        """Remember all clouds, on the device, for stretches that must be made again."""
        for kept, array in zip(self._before, self._arrays().values(), strict=True):
            kept.copy_from(array)

    def _take_back(self, again: Sequence[int]) -> None:
        """Take clouds back to what `_keep` remembered."""
        mask = np.zeros(len(self.clouds), np.int32)
        mask[list(again)] = 1
        self._again.from_numpy(mask)
        now = self._arrays().values()
        gpu_kernels.restore(self._again, self._cloud, *now, *self._before)

    @property
    def megabytes(self) -> float:
        """Memory on the device: particles, nodes, distance grids."""
        particles = 180 * int(self._first[-1])
        return (particles + 60 * self._nodes.shape[0] + 4 * self._sdf.shape[0]) / 1e6

    def _launch(self, left: np.ndarray) -> np.ndarray:
        """Make the substeps that are left, or as many as there are nodes for: rows of state."""
        for n in range(int(left.max())):
            if n == 0:
                self._look_first(left)
            elif n % EVERY == 0:
                self._look(n)
            gpu_kernels.substep(
                n, self._x, self._v, self._C, self._b, self._largest, self._cloud, self._numbers,
                self._counts, self._state, self._used, self._owner, self._nodes, self._colliders,
                self._room, self._touch, self._sdf,
            )  # fmt: skip
        return self._state.to_numpy()

    def _look_first(self, left: np.ndarray) -> None:
        """Set the limits and look; again with more nodes where these are too few."""
        for _ in range(2):
            state = np.zeros((len(left), gpu_rows.STATE), np.int32)
            state[:, gpu_rows.LIMIT] = left
            state[:, gpu_rows.DETAIL] = np.iinfo(np.int32).max  # the lowest one is kept
            self._state.from_numpy(state)
            self._used.fill(0)
            self._look(0)
            needed = int(self._used.to_numpy()[1])
            if needed <= self._owner.shape[0]:
                break
            self._make_nodes(int(np.ceil(SPARE * needed)))

    def _look(self, n: int) -> None:
        gpu_kernels.look(
            n, self._x, self._cloud, self._numbers, self._counts, self._state, self._used,
            self._owner, self._colliders, self._free, self._room, self._touch, self._sdf,
        )  # fmt: skip

    def _make_nodes(self, blocks: int) -> None:
        total = blocks * gpu_rows.BLOCK
        self._owner = ti.ndarray(ti.i32, blocks)
        self._owner.fill(0)
        self._nodes = ti.Vector.ndarray(4, ti.f32, total)
        self._colliders = ti.Vector.ndarray(4, ti.f32, 2 * total)
        self._free, self._room = (ti.ndarray(ti.f32, total) for _ in "ab")
        self._touch = ti.ndarray(ti.i32, total)

    def _load_fingers(self, stretches: Sequence[Stretch | None]) -> None:
        """Bring distance grids that were not used before to the device."""
        known = len(self._fingers)
        for stretch in stretches:
            sdf = stretch.squeeze.sdf if stretch is not None and stretch.squeeze else None
            if sdf is not None and not any(sdf is finger for finger in self._fingers):
                self._fingers.append(sdf)
        if len(self._fingers) > known:
            sizes = np.cumsum([0, *(finger.values.size for finger in self._fingers)]).tolist()
            pairs = zip(self._fingers, sizes, strict=False)
            self._sdf_first = {id(finger): first for finger, first in pairs}
            self._sdf = ti.ndarray(ti.f32, sizes[-1])
            self._sdf.from_numpy(np.concatenate([f.values.reshape(-1) for f in self._fingers]))

    def _rows(self, cloud: Solver, stretch: Stretch, steps: int) -> tuple[list, list]:
        squeeze = stretch.squeeze
        if squeeze is not None and squeeze.position != cloud._middle:
            cloud._middle = squeeze.position
            cloud._grid = grid_of(cloud.physics, cloud._middle)
        grid, dough, contact = cloud._grid, cloud._dough, contact_of(cloud.physics, squeeze)
        first = 0 if squeeze is None else self._sdf_first[id(squeeze.sdf)]
        return (
            gpu_rows.pack_numbers(
                dt=stretch.seconds / steps, grid=grid, dough=dough, contact=contact
            ),
            gpu_rows.pack_counts(sdf_first=first, grid=grid, contact=contact),
        )

    def _particle_arrays(self, count: int) -> tuple[Any, ...]:
        return (
            ti.Vector.ndarray(3, ti.f32, count),
            ti.Vector.ndarray(3, ti.f32, count),
            ti.Matrix.ndarray(3, 3, ti.f32, count),
            ti.Vector.ndarray(6, ti.f32, count),
            ti.ndarray(ti.f32, count),
        )

    def _arrays(self) -> dict[str, Any]:
        return {"x": self._x, "v": self._v, "C": self._C, "b": self._b, "largest": self._largest}

    def _fetch(self, names: Sequence[str]) -> None:
        arrays = self._arrays()
        for name in names:
            values = arrays[name].to_numpy()
            for cloud, (a, b) in zip(self.clouds, pairwise(self._first), strict=True):
                getattr(cloud, name)[:] = values[a:b]

    def _error(self, k: int, status: int, detail: int) -> SimulationError:
        if status == CFL_BROKEN:
            detail -= int(self._first[k])
        try:
            self.clouds[k].check(np.array([status, detail], np.int32))
        except SimulationError as error:
            return error
        return SimulationError(f"the cloud failed for an unknown reason ({status})")
