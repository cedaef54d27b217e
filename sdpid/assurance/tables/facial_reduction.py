"""Facial reduction: the linear subspace of weights whose matrices can be positive definite.

A point mass on an axis that nothing moves, and much else, adds nothing to any base parameter: the
coefficients of such directions are zero whatever the weights. Where a matrix that is to be
positive semidefinite has a zero on its diagonal, its whole row must vanish, which is a linear
condition on the weights. Solved in rationals, it leaves matrices that can be definite on the
rest, so that weights may be rounded.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.witness import Question
from sdpid.robot.inertia import TENSOR_INDEX
from sdpid.verifier.realizable import Vector

# Coefficients of a link's ten parameters in the entries of its matrices.
_TENSOR = {pair: 4 + k for k, pair in enumerate(TENSOR_INDEX)}


@dataclass(frozen=True, eq=False)
class Face:
    """The subspace of weights that satisfy the linear conditions.

    Attributes
    ----------
    support : tuple of int
        The parameters that may have a weight.
    solved : dict
        Weights that follow from the free ones: parameter -> {free parameter: factor}.
    free : tuple of int
        The parameters whose weights are free.
    alive : tuple of tuple of list of int
        Of each link, the rows of C and of Q that are not zero whatever the weights.
    """

    support: tuple[int, ...]
    solved: dict[int, Vector]
    free: tuple[int, ...]
    alive: tuple[tuple[list[int], list[int]], ...]

    def matrix(self) -> Array:
        """Return the map from free weights to those of the support."""
        out = np.zeros((len(self.support), len(self.free)))
        column = {k: i for i, k in enumerate(self.free)}
        for i, k in enumerate(self.support):
            for free, factor in self.solved.get(k, {k: Fraction(1)}).items():
                out[i, column[free]] = float(factor)
        return out

    def weights(self, free: dict[int, Fraction]) -> dict[int, Fraction]:
        """Return all weights of given free ones, exactly."""
        out = {}
        for k in self.support:
            terms = self.solved.get(k, {k: Fraction(1)})
            out[k] = sum((x * free[j] for j, x in terms.items()), Fraction(0))
        return out


class _Conditions:
    """Linear equations in reduced form."""

    def __init__(self) -> None:
        self.solved: dict[int, Vector] = {}

    def reduce(self, row: Vector) -> Vector:
        out: Vector = {}
        for k, value in row.items():
            for j, factor in self.solved.get(k, {k: Fraction(1)}).items():
                out[j] = out.get(j, Fraction(0)) + value * factor
        return {k: value for k, value in out.items() if value}

    def add(self, row: Vector) -> bool:
        """Demand that a combination of weights vanishes; False where it does already."""
        row = self.reduce(row)
        if not row:
            return False
        pivot = max(row)
        lead = row.pop(pivot)
        self.solved[pivot] = {k: -value / lead for k, value in row.items()}
        self.solved = {k: self.reduce(terms) for k, terms in self.solved.items()}
        return True


def find_face(question: Question, support: Iterable[int], *, mass_bound: bool) -> Face:
    """Return the subspace of weights over a support that can make a refutation.

    Parameters
    ----------
    question : Question
        The table and the constraints.
    support : iterable of int
        The parameters that may have a weight.
    mass_bound : bool
        Whether masses may be taken to be bounded: then their coefficients need not vanish.
    """
    chosen = tuple(support)
    columns: dict[int, Vector] = {}
    for k in chosen:
        for j, value in question.rows[k].items():
            columns.setdefault(j, {})[k] = value
    conditions = _Conditions()
    first = 10 * question.n_links
    for j, column in columns.items():
        if j >= first and j not in question.nonnegative:
            conditions.add(column)
    touched = sorted({j // 10 for j in columns if j < first})
    spatial = question.consistency == "spatial_inertia"

    def entries(link: int) -> tuple[dict[tuple[int, int], Vector], dict[tuple[int, int], Vector]]:
        part = [columns.get(10 * link + k, {}) for k in range(10)]
        C = {pair: part[k] for pair, k in _TENSOR.items()}
        Q = dict(C)
        for i in range(3):
            a, b = (C[j, j] for j in range(3) if j != i)
            Q[i, i] = {k: a.get(k, Fraction(0)) + b.get(k, Fraction(0)) for k in {*a, *b}}
            Q[i, 3] = part[1 + i]
        Q[3, 3] = part[0]
        return C, Q

    matrices = {link: entries(link) for link in touched}

    def dead(matrix: dict[tuple[int, int], Vector], i: int, bounded: bool) -> bool:
        return not bounded and not conditions.reduce(matrix[i, i])

    changed = True
    while changed:
        changed = False
        for C, Q in matrices.values():
            for matrix, size in ((C, 3), (Q, 4)) if spatial else ((Q, 4),):
                for i in range(size):
                    if dead(matrix, i, mass_bound and i == 3):
                        for pair, entry in matrix.items():
                            if i in pair:
                                changed |= conditions.add(entry)
    alive: list[tuple[list[int], list[int]]] = []
    for link in range(question.n_links):
        if link not in matrices:
            alive.append(([], []))
            continue
        C, Q = matrices[link]
        rows = [i for i in range(4) if not dead(Q, i, mass_bound and i == 3)]
        own = [i for i in range(3) if not dead(C, i, False)] if spatial else []
        alive.append((own, rows))
    free = tuple(k for k in chosen if k not in conditions.solved)
    return Face(chosen, conditions.solved, free, tuple(alive))
