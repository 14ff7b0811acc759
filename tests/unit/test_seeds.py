"""Seeds."""

import numpy as np

from doughdata.seeds import seed_sequence


def draw(*key: object) -> tuple:
    return tuple(np.random.default_rng(seed_sequence(*key)).integers(2**62, size=4))


def test_streams_differ_by_every_part_of_the_key() -> None:
    """Root, family, split, number and stage each change the stream; the same key repeats it."""
    base = (0, "rolls", "train", 3, "simulate")
    others = [
        (1, *base[1:]),
        (0, "doughnut", *base[2:]),
        (0, "rolls", "test", 3, "simulate"),
        (0, "rolls", "train", 4, "simulate"),
        (0, "rolls", "train", 3, "scene"),
    ]
    assert draw(*base) == draw(*base)
    assert len({draw(*base), *(draw(*other) for other in others)}) == 6
