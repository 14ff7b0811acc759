"""Rules for every test: a docstring that says what must hold; array shapes are checked."""

import pytest
from jaxtyping import install_import_hook

# Not the kernels of doughdata.sim: Taichi reads their source.
SHAPES = (
    *("scenes", "topology", "mesh", "render", "geometry", "dataset", "torch"),
    "exporters",
    *(f"recordings.{name}" for name in ("cloud", "colour", "compressed_depth", "dough", "images")),
    *(f"recordings.{name}" for name in ("pairing", "rvl", "spooling", "table", "workspace")),
    *("sim.mpm", "sim.pull", "sim.solver", "sim.batch", "sim.script", "sim.scene_run"),
)
MODEL = (
    *("attention", "features", "autoencoder", "dynamics", "folded", "hierarchical", "losses"),
    *("metrics", "model", "lattice", "procedural", "augment", "evaluate"),
)
CHECKED = [*(f"doughdata.{name}" for name in SHAPES), *(f"doughnet.{name}" for name in MODEL)]
install_import_hook(CHECKED, "beartype.beartype")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse a test without a docstring."""
    for item in items:
        function = getattr(item, "function", None)
        if function is not None and not (function.__doc__ or "").strip():
            raise pytest.UsageError(f"{item.nodeid} needs a docstring that says what must hold")
