"""Seeds that depend on what is made, never on who makes it or when."""

from hashlib import sha256

import numpy as np

__all__ = ["seed_sequence"]


def seed_sequence(root: int, *key: str | int) -> np.random.SeedSequence:
    """Independent stream for a key, e.g. `(family, split, number, stage)`.

    Strings are hashed (sha256, 32 bit), so the stream is the same for any number of workers,
    machine or order. 0 is a valid root.
    """
    words = tuple(
        part if isinstance(part, int) else int.from_bytes(sha256(part.encode()).digest()[:4])
        for part in key
    )
    return np.random.SeedSequence(root, spawn_key=words)
