"""Shape checks for every test: jaxtyping annotations are enforced by beartype."""

from jaxtyping import install_import_hook

hook = install_import_hook(
    ["doughdata.scenes", "doughdata.topology", "doughdata.mesh", "doughdata.render", "doughdata.geometry"],
    "beartype.beartype",
)
