"""Any closed mesh as the dough: `mesh:FILE`."""

from pathlib import Path

import numpy as np

from doughdata.geometry import matrix_to_quaternion, rotation_vector_to_matrix
from doughdata.scenes.sampling import Draft, between, sample_action, sample_scene
from doughdata.scenes.shapes.mesh import body_mesh, mesh_digest
from doughschemas import Action, Body, Scene, SceneError

__all__ = ["MeshBodies"]

# Radius [m] of the ball of equal volume at body scale 0 and 1: as much dough as in the rolls.
EQUIVALENT_RADIUS = (0.012, 0.020)
LONGEST = 0.090  # [m], longest side at body scale 1; slender meshes get less dough instead
# Which side lies down: rotation vectors [rad] that bring each of the six sides to the table.
SIDES = np.pi * np.array(
    [(0, 0, 0), (1, 0, 0), (0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0), (0, -0.5, 0)]
)


class MeshBodies:
    """Your own watertight mesh (`mesh:FILE`), scaled to the usual sizes, on any of its sides."""

    def __init__(self, file: str | Path | None = None) -> None:
        self.file = file

    def sample(self, *, seed: int, number: int, split: str) -> Scene:
        """Scene `number` of a split; scales and poses depend on the key, not on the file's name.

        The mesh is scaled between 12/20 of its largest size and that size, which is the one whose
        volume is that of a ball of 20 mm radius, or whose longest side is 90 mm if that is smaller.

        Raises:
            SceneError: no file, or a mesh that is not one watertight surface.
        """
        if self.file is None:
            raise SceneError("scene family 'mesh' needs a file: mesh:FILE (STL, OBJ, GLB or PLY)")
        file, sizes = str(self.file), scale_range(self.file)

        def bodies(scale: float, rng: np.random.Generator) -> tuple[Body, ...]:
            return (_body(file, sizes, scale, rng),)

        return sample_scene(
            "mesh",
            seed=seed,
            number=number,
            split=split,
            bodies=bodies,
            action=_action,
            label=f"mesh-{mesh_digest(file)[:8]}",
        )


def scale_range(file: str | Path) -> tuple[float, float]:
    """Metres a mesh unit at body scale 0 and 1."""
    mesh = body_mesh(file)
    low, high = EQUIVALENT_RADIUS
    radius = float(np.cbrt(3.0 * abs(mesh.volume) / (4.0 * np.pi)))
    largest = min(high / radius, LONGEST / float(np.max(mesh.extents)))
    return largest * low / high, largest


def _body(file: str, sizes: tuple[float, float], scale: float, rng: np.random.Generator) -> Body:
    side = rotation_vector_to_matrix(SIDES[rng.integers(len(SIDES))])
    quaternion = matrix_to_quaternion(side).round(9) + 0.0  # no negative zeros
    metres = sizes[0] + (sizes[1] - sizes[0]) * scale
    return Body(
        shape="mesh",
        parameters={
            "file": file,
            "scale": float(f"{metres:.6g}"),
            **{f"q{axis}": float(q) for axis, q in zip("xyzw", quaternion, strict=True)},
        },
        yaw=between(-np.pi, np.pi, rng.random()),
    )


def _action(draft: Draft, rng: np.random.Generator) -> Action:
    return sample_action(draft.tool, rng, reach=(0.012, 0.012), yaw=np.pi, opening=0.018)
