import numpy as np

from doughdata.topology.pairs import connected, decode, encode, near_keys, rows_of, without
from doughdata.topology.pulls import disjoint_paths


def test_pair_keys_round_trip() -> None:
    """Decoding the keys of a set of pairs gives the set back, lower particle first and sorted."""
    pairs = np.array([[3, 1], [0, 4], [2, 0]])
    assert decode(encode(pairs, 5), 5).tolist() == [[0, 2], [0, 4], [1, 3]]


def test_near_keys_are_all_near_pairs() -> None:
    """The near pairs are exactly those that a full table of distances shows."""
    x = np.random.default_rng(1).uniform(size=(60, 3))
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    expected = np.argwhere(np.triu(distance < 0.3, 1))
    assert decode(near_keys(x, 0.3), 60).tolist() == expected.tolist()


def test_set_difference_of_keys() -> None:
    """Taking a table out of a set of keys leaves what Python's sets leave."""
    a, b = np.array([1, 4, 7, 9]), np.array([0, 4, 9])
    assert set(without(a, b).tolist()) == {1, 7}
    assert without(a, b[:0]).tolist() == a.tolist()


def test_connected_without_pairs() -> None:
    """Without pairs every particle is a piece of its own."""
    assert len(set(connected(np.zeros((0, 2), np.int64), 4).tolist())) == 4


def test_disjoint_paths_of_a_bundle() -> None:
    """A bundle of k separate threads between two blocks has k vertex-disjoint paths."""
    threads = [(0.0, 3.0 * k, float(z)) for k in range(4) for z in range(1, 6)]
    ends = [(0.0, 3.0 * k, float(z)) for k in range(4) for z in (0, 6)]
    x = np.array(threads + ends)
    first, second = x[:, 2] == 0, x[:, 2] == 6
    assert disjoint_paths(x, first, second, 1.1) == 4


def test_disjoint_paths_through_a_bottleneck() -> None:
    """Two sheets joined by one particle have one path, apart from it none."""
    sheet = [(x, y, z) for x in range(3) for y in range(3) for z in (0.0, 2.0)]
    x = np.array([*sheet, (1, 1, 1.0)], dtype=float)
    first, second = x[:, 2] == 0, x[:, 2] == 2
    assert disjoint_paths(x, first, second, 1.1) == 1
    assert disjoint_paths(x[:-1], first[:-1], second[:-1], 1.1) == 0


def test_pieces_of_many_pairs_match_a_search() -> None:
    """Pieces found from many pairs are those that a plain breadth-first search finds."""
    rng = np.random.default_rng(2)
    count = 60
    pairs = rng.integers(0, count, (40 * count, 2))
    pairs = pairs[(pairs[:, 0] < 20) == (pairs[:, 1] < 20)]  # two parts at least
    pairs = pairs[(pairs != 7).all(axis=1)]  # and a lone particle
    piece = np.full(count, -1)
    for start in range(count):
        front = [start] if piece[start] < 0 else []
        number = piece.max() + 1
        while front:
            now = front.pop()
            if piece[now] < 0:
                piece[now] = number
                front += pairs[pairs[:, 0] == now, 1].tolist()
                front += pairs[pairs[:, 1] == now, 0].tolist()
    assert connected(pairs, count).tolist() == piece.tolist()


def test_rows_of_keys() -> None:
    """The rows found in a sorted table are those of the keys that it holds."""
    assert rows_of(np.array([9, 2, 4]), np.array([1, 4, 9])).tolist() == [2, 1]
    assert rows_of(np.array([3]), np.zeros(0, np.int64)).tolist() == []
