"""The bond graph: which near particles belong together, carried from key frame to key frame.

Two particles closer than `reach` are either bonded or in contact (near, but not of one piece). A
pair that comes near inherits from its surroundings; only a passed pull test bonds two components.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64, UInt8
from scipy.sparse import csr_matrix

from doughdata.topology.pairs import (
    adjacency,
    connected,
    decode,
    is_member,
    lengths,
    near_keys,
    without,
)

__all__ = ["BondGraph"]


class BondGraph:
    """Bonded and contact pairs of one key frame.

    Lengths are in spacings: `reach` of a pair, `link` of a bond that holds a component, `near`
    of the neighbours asked when a pair inherits. A new pair is bonded if at least the share
    `support_new` of its common neighbours is bonded to both ends (`support_old` for a contact
    pair), in two passes.
    """

    def __init__(
        self,
        positions: Float64[np.ndarray, "particles 3"],
        object_ids: UInt8[np.ndarray, " particles"],
        spacing: float,
        *,
        reach: float,
        link: float,
        start: float,
        support_new: float,
        support_old: float,
    ) -> None:
        self.spacing, self.reach, self.link = spacing, reach, link
        self.support_new, self.support_old = support_new, support_old
        self.positions = positions
        self.count = len(positions)
        self.near = near_keys(positions, reach * spacing)
        pairs = decode(self.near, self.count)
        self.lengths = lengths(positions, pairs)  # [m], of the near pairs
        same = object_ids[pairs[:, 0]] == object_ids[pairs[:, 1]]
        short = self.lengths < start * spacing
        body = connected(pairs[same & short], self.count)
        self.contacts = self.near[body[pairs[:, 0]] != body[pairs[:, 1]]]
        self.cuts: list[UInt8[np.ndarray, " particles"]] = []  # side 1 or 2 of each cut
        self.crossed = np.zeros(0, np.int64)  # pairs with a finger between them

    def bonded_keys(self, longest: float) -> Int64[np.ndarray, " bonds"]:
        """Keys of the bonded pairs shorter than `longest` spacings."""
        return without(self.near[self.lengths < longest * self.spacing], self.contacts)

    def bonded_pairs(self, longest: float) -> Int64[np.ndarray, "bonds 2"]:
        """Bonded pairs shorter than `longest` spacings."""
        return decode(self.bonded_keys(longest), self.count)

    def pieces(self) -> Int32[np.ndarray, " particles"]:
        """Piece of each particle: what short bonds hold together."""
        return connected(self.bonded_pairs(self.link), self.count)

    def advance(self, positions: Float64[np.ndarray, "particles 3"]) -> None:
        """Carry the graph to the next key frame."""
        near = near_keys(positions, self.reach * self.spacing)
        known = is_member(near, self.near)
        contact = is_member(near, self.contacts)
        self.positions, self.near = positions, near
        self.lengths = lengths(positions, decode(near, self.count))
        bonded = near[known & ~contact]
        pending = near[~known | contact]
        limit = np.where(known[~known | contact], self.support_old, self.support_new)
        free = ~self.locked(pending)
        made = self._inherit(bonded, pending[free], limit[free])
        made = self._within_pieces(bonded, made)
        self.contacts = without(pending, made)

    def _inherit(
        self,
        bonded: Int64[np.ndarray, " bonds"],
        pending: Int64[np.ndarray, " pending"],
        limit: Float64[np.ndarray, " pending"],
    ) -> Int64[np.ndarray, " made"]:
        """Pending pairs whose common neighbours are bonded to both ends."""
        made = np.zeros(0, np.int64)
        if len(pending) == 0:
            return made
        pairs = decode(pending, self.count)
        all_near = _common(adjacency(decode(self.near, self.count), self.count), pairs)
        for _ in range(2):
            graph = adjacency(decode(np.concatenate([bonded, made]), self.count), self.count)
            share = _common(graph, decode(pending, self.count)) / np.maximum(all_near, 1)
            accepted = (share >= limit) & (all_near > 0)
            made = np.sort(np.concatenate([made, pending[accepted]]))
            pending, limit, all_near = pending[~accepted], limit[~accepted], all_near[~accepted]
            if len(pending) == 0:
                break
        return made

    def _within_pieces(
        self, bonded: Int64[np.ndarray, " bonds"], made: Int64[np.ndarray, " made"]
    ) -> Int64[np.ndarray, " _"]:
        """Drop new bonds between components: those need a passed pull test."""
        if len(made) == 0:
            return made
        piece = connected(decode(bonded, self.count), self.count)
        ends = decode(made, self.count)
        return made[piece[ends[:, 0]] == piece[ends[:, 1]]]

    def locked(self, keys: Int64[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
        """Which pairs lie across a cut of this action, or have had a finger between them."""
        found = is_member(keys, self.crossed)
        pairs = decode(keys, self.count)
        for side in self.cuts:
            found |= side[pairs[:, 0]] * side[pairs[:, 1]] == 2
        return found

    def start_action(self) -> None:
        """A new squeeze may join what an earlier one has cut."""
        self.cuts = []
        self.crossed = np.zeros(0, np.int64)

    def join(self, keys: Int64[np.ndarray, " pairs"]) -> None:
        """Bond contact pairs, and all other contacts among their particles."""
        ends = np.zeros(self.count, dtype=bool)
        ends[decode(keys, self.count).ravel()] = True
        pairs = decode(self.contacts, self.count)
        inside = ends[pairs[:, 0]] & ends[pairs[:, 1]] & ~self.locked(self.contacts)
        self.contacts = without(self.contacts[~inside], np.sort(keys))

    def cut(self, side: UInt8[np.ndarray, " particles"]) -> None:
        """Break every bond between side 1 and side 2 until the next action."""
        self.separate(side)
        self.cuts.append(side.astype(np.uint8))

    def separate(self, side: UInt8[np.ndarray, " particles"]) -> None:
        """Break every bond between side 1 and side 2."""
        pairs = decode(self.near, self.count)
        self._break(self.near[side[pairs[:, 0]] * side[pairs[:, 1]] == 2])

    def cross(self, keys: Int64[np.ndarray, " pairs"]) -> None:
        """Break the bonds that a finger passes through, until the next action."""
        self._break(keys)
        self.crossed = np.union1d(self.crossed, keys)

    def _break(self, keys: Int64[np.ndarray, " pairs"]) -> None:
        self.contacts = np.union1d(self.contacts, keys)


def _common(
    graph: csr_matrix, pairs: Int64[np.ndarray, "pairs 2"]
) -> Float64[np.ndarray, " pairs"]:
    """Number of common neighbours of the two ends of each pair."""
    both = graph[pairs[:, 0]].multiply(graph[pairs[:, 1]])
    return np.asarray(both.sum(axis=1), dtype=np.float64).ravel()
