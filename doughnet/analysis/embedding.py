"""Where frames lie in latent space: t-SNE of standardised latents, reduced to 32 numbers first."""

import numpy as np
from jaxtyping import Float, Float64

from doughnet.extras import train_package

__all__ = ["embed"]

REDUCED = 32  # principal components, as the paper takes
PERPLEXITY = 30.0


def embed(
    latents: Float[np.ndarray, "frames width"], *, seed: int = 0
) -> Float64[np.ndarray, "frames 2"]:
    """Places of frames on a plane; near ones are alike."""
    decomposition, manifold = (
        train_package(f"sklearn.{name}") for name in ("decomposition", "manifold")
    )
    values = np.asarray(latents, np.float64)
    spread = values.std(axis=0)
    values = (values - values.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    parts = min(REDUCED, *values.shape)
    values = decomposition.PCA(n_components=parts, random_state=seed).fit_transform(values)
    tsne = manifold.TSNE(
        perplexity=min(PERPLEXITY, max(1.0, (len(values) - 1) / 3)), random_state=seed, init="pca"
    )
    return tsne.fit_transform(values).astype(np.float64)
