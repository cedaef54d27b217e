"""Which columns the rows of a robot's branches have, so that they are compressed by themselves.

A joint's row has the parameters of the links that it moves, and no others. Of a quadruped, the rows
of a leg have a quarter of all columns; compressed alone, such a row costs a sixteenth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.compression.triangle import Triangle
from sdpid.robot.model.regressor_kernel import Tree

# A branch has at most this share of the columns; its rows cost the square of it.
_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Branches:
    """Joints whose rows have few columns.

    Attributes
    ----------
    of_row : ndarray of int, shape (n,)
        The branch of each row, -1 for none.
    columns : tuple of ndarray of int
        Of each branch, the columns where its rows may not be zero.
    """

    of_row: Indices
    columns: tuple[Indices, ...]

    @classmethod
    def of(cls, reached: Mask) -> Branches:
        """Find branches by which rows reach which columns, shape (n, columns)."""
        of_row = np.full(len(reached), -1, dtype=np.intp)
        found: list[Mask] = []
        size = np.count_nonzero(reached, axis=1)
        for i in np.argsort(-size, kind="stable"):
            if size[i] > _SHARE * reached.shape[1]:
                continue
            # That which it shares most with, if both are still one branch.
            shared = [np.count_nonzero(own & reached[i]) for own in found]
            best = int(np.argmax(shared)) if shared else -1
            if best >= 0 and 2 * shared[best] > size[i]:
                both = found[best] | reached[i]
                if np.count_nonzero(both) <= _SHARE * reached.shape[1]:
                    found[best], of_row[i] = both, best
                    continue
            of_row[i] = len(found)
            found.append(reached[i].copy())
        return cls(of_row, tuple(np.flatnonzero(own) for own in found))

    def split(self, rows: Array) -> tuple[Array, list[Array]]:
        """Return the rows (k, n, c) of no branch, (r, c), and those of each with its columns."""
        parts = []
        for b, columns in enumerate(self.columns):
            own = np.flatnonzero(self.of_row == b)
            parts.append(rows[:, own[:, None], columns].reshape(-1, len(columns)))
        return rows[:, self.of_row < 0].reshape(-1, rows.shape[2]), parts

    def join(self, triangle: Triangle, apart: Sequence[Triangle]) -> None:
        """Fold the triangles of the branches into that of all columns."""
        for own, columns in zip(apart, self.columns, strict=True):
            triangle.add(own.R, columns)


# Rows that are not told apart.
NO_BRANCHES = Branches(np.zeros(0, dtype=np.intp), ())


def moved(tree: Tree) -> Mask:
    """Return which coordinates move which links, shape (n, links)."""
    links = len(tree.kind)
    found = np.zeros((tree.n, links), dtype=bool)
    ends = [*tree.first_v[1:], len(tree.column)]
    for i in range(links):
        if tree.parent[i] >= 0:
            found[:, i] = found[:, tree.parent[i]]
        found[tree.column[tree.first_v[i] : ends[i]], i] = True
    return found
