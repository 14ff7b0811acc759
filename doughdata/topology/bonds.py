"""The bond graph: which near particles belong together, carried from key frame to key frame.

Two particles closer than `reach` are either bonded or in contact (near, but not of one piece). A
pair that comes near inherits from its surroundings; only a passed pull test bonds two components.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int32, Int64, UInt8
from scipy.sparse import coo_matrix, csr_matrix

from doughdata.topology.pairs import connected, decode, is_member, lengths, near_keys, rows_of

__all__ = ["BondGraph"]

BOTH = 1 << 20  # more than any particle has neighbours
MANY = 5000  # contacts


class BondGraph:
    """Bonded and contact pairs of one key frame.

    Lengths are in spacings: `reach` of a pair, `link` of a bond that holds a component. A new pair
    is bonded if at least the share `support_new` of its common neighbours is bonded to both ends
    (`support_old` for a contact pair; both above 0), in two passes.

    `near` are the keys of all near pairs, sorted; `pairs`, `lengths` [m] and `contact` (in contact,
    else bonded) have a row for each.
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
        self.count = len(positions)
        self._place(positions)
        same = object_ids[self.pairs[:, 0]] == object_ids[self.pairs[:, 1]]
        body = connected(self.pairs[same & (self.lengths < start * spacing)], self.count)
        self.contact = body[self.pairs[:, 0]] != body[self.pairs[:, 1]]
        self.cuts: list[UInt8[np.ndarray, " particles"]] = []  # side 1 or 2 of each cut
        self.crossed = np.zeros(0, np.int64)  # keys of pairs that had a finger between them

    def _place(self, positions: Float64[np.ndarray, "particles 3"]) -> None:
        self.positions = positions
        self.near = near_keys(positions, self.reach * self.spacing)
        self.pairs = decode(self.near, self.count)
        self.lengths = lengths(positions, self.pairs)
        self._rows: dict[float, Int64[np.ndarray, " bonds"]] = {}  # of bonds up to a length

    @property
    def contacts(self) -> Int64[np.ndarray, " contacts"]:
        """Keys of the contact pairs."""
        return self.near[self.contact]

    def bonded_keys(self, longest: float) -> Int64[np.ndarray, " bonds"]:
        """Keys of the bonded pairs shorter than `longest` spacings."""
        return self.near[self._short(longest)]

    def bonded_pairs(self, longest: float) -> Int64[np.ndarray, "bonds 2"]:
        """Bonded pairs shorter than `longest` spacings."""
        return self.pairs.take(self._short(longest), axis=0)

    def _short(self, longest: float) -> Int64[np.ndarray, " bonds"]:
        if longest not in self._rows:
            short = (self.lengths < longest * self.spacing) & ~self.contact
            self._rows[longest] = np.flatnonzero(short)
        return self._rows[longest]

    def pieces(self) -> Int32[np.ndarray, " particles"]:
        """Piece of each particle: what short bonds hold together."""
        return connected(self.bonded_pairs(self.link), self.count)

    def touching(self, radius: float) -> Int32[np.ndarray, " particles"]:
        """Piece of each particle if everything within `radius` spacings (<= `reach`) were one."""
        rows = np.flatnonzero(self.lengths < radius * self.spacing)
        return connected(self.pairs.take(rows, axis=0), self.count)

    def advance(self, positions: Float64[np.ndarray, "particles 3"]) -> None:
        """Carry the graph to the next key frame."""
        before, contacts = self.near, self.contacts
        moved = np.sqrt(((positions - self.positions) ** 2).sum(axis=1))
        self._place(positions)
        # Both ends together moved less than a pair is short of `reach`: it was near before, too.
        way = moved.take(self.pairs[:, 0]) + moved.take(self.pairs[:, 1])
        asked = np.flatnonzero(self.lengths + way > (self.reach - 1e-6) * self.spacing)
        new = asked[~is_member(self.near[asked], before)]
        self.contact = np.zeros(len(self.near), dtype=bool)
        self.contact[rows_of(contacts, self.near)] = True
        limit = np.full(len(self.near), self.support_old)
        limit[new] = self.support_new
        self.contact[new] = True
        # With a neighbour bonded to both ends, these are of one component already: no pair across
        # components is ever bonded here.
        pending = np.flatnonzero(self.contact)
        if len(pending) > MANY:  # worth finding the components
            whole = connected(self.bonded_pairs(self.reach), self.count)
            ends = self.pairs.take(pending, axis=0)
            pending = pending[whole.take(ends[:, 0]) == whole.take(ends[:, 1])]
        pending = pending[~self.locked(pending)]
        self._mark(self._inherit(pending, limit[pending]), contact=False)

    def _mark(self, rows: Int64[np.ndarray, " rows"], *, contact: bool) -> None:
        self.contact[rows] = contact
        self._rows.clear()

    def _inherit(
        self, pending: Int64[np.ndarray, " pending"], limit: Float64[np.ndarray, " pending"]
    ) -> Int64[np.ndarray, " made"]:
        """Rows of pending pairs whose common neighbours are bonded to both ends."""
        made = np.zeros(0, np.int64)
        if len(pending) == 0:
            return made
        matrix, row = self._neighbours(self.pairs[pending])
        bonded = ~self.contact
        for _ in range(2):
            matrix.data = 1.0 + BOTH * bonded[row]
            near, held = _common(matrix, self.pairs[pending])
            accepted = held / np.maximum(near, 1) >= limit
            made = np.concatenate([made, pending[accepted]])
            bonded[made] = True
            pending, limit = pending[~accepted], limit[~accepted]
            if len(pending) == 0:
                break
        return np.sort(made)

    def _neighbours(
        self, asked: Int64[np.ndarray, "asked 2"]
    ) -> tuple[csr_matrix, Int64[np.ndarray, " entries"]]:
        """Near pairs of the particles asked about, as a matrix, and the row of each entry."""
        wanted = np.zeros(self.count, dtype=bool)
        wanted[asked] = True
        up, down = (np.flatnonzero(wanted[self.pairs[:, k]]) for k in (0, 1))
        # Lower neighbours first: so the columns of every row come out sorted.
        rows = np.concatenate([self.pairs[down, 1], self.pairs[up, 0]])
        columns = np.concatenate([self.pairs[down, 0], self.pairs[up, 1]])
        entry = np.concatenate([down, up]).astype(np.float64)
        matrix = csr_matrix(coo_matrix((entry, (rows, columns)), (self.count, self.count)))
        return matrix, matrix.data.astype(np.int64)

    def locked(self, rows: Int64[np.ndarray, " rows"]) -> Bool[np.ndarray, " rows"]:
        """Which near pairs lie across a cut of this action, or have had a finger between them."""
        found = is_member(self.near[rows], self.crossed)
        pairs = self.pairs[rows]
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
        ends[decode(keys, self.count)] = True
        rows = np.flatnonzero(self.contact)
        inside = rows[ends[self.pairs[rows]].all(axis=1)]
        self._mark(inside[~self.locked(inside)], contact=False)
        self._mark(rows_of(keys, self.near), contact=False)

    def cut(self, side: UInt8[np.ndarray, " particles"]) -> None:
        """Break every bond between side 1 and side 2 until the next action."""
        across = side[self.pairs[:, 0]] * side[self.pairs[:, 1]] == 2
        self._mark(np.flatnonzero(across), contact=True)
        self.cuts.append(side.astype(np.uint8))

    def cross(self, rows: Int64[np.ndarray, " rows"]) -> None:
        """Break the bonds that a finger passes through, until the next action."""
        self._mark(rows, contact=True)
        self.crossed = np.union1d(self.crossed, self.near[rows])


def _common(
    matrix: csr_matrix, pairs: Int64[np.ndarray, "pairs 2"]
) -> tuple[Int64[np.ndarray, " pairs"], Int64[np.ndarray, " pairs"]]:
    """Number of common neighbours of the two ends of each pair, and of those bonded to both.

    An entry is 1 for a near pair and 1 + BOTH for a bonded one. The sum of products over the common
    neighbours is then their number + BOTH * ... + BOTH^2 * the number bonded to both: one product
    of sparse rows instead of two, exact in double precision.
    """
    total = matrix[pairs[:, 0]].multiply(matrix[pairs[:, 1]]).sum(axis=1)
    total = np.asarray(total).ravel().astype(np.int64)
    return total % BOTH, total // BOTH**2
