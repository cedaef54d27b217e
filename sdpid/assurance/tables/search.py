"""Cone programs that look for witnesses and for the smallest change of a table, with their duals.

Everything here is in floating point and only proposes. Multipliers of a program's rows are the
weights of an inequality that all bodies obey: rounded to rationals they are a proof, which
`sdpid.verifier.realizable` decides, whatever the solver says.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.answers import StoredRefutation
from sdpid.estimation.conic.solve import (
    ConicProgram,
    ConicSolution,
    Matrix,
    solve_conic,
    solve_with_retries,
)
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.robot.inertia import from_pseudo_inertia, margin, margin_shift, matrix_basis
from sdpid.verifier.decimals import rounded
from sdpid.verifier.exact import positive_semidefinite
from sdpid.verifier.realizable import Question

# Witnesses keep this share of its width away from the ends of the box, and of the bounds, so that
# rounding does not carry them out of it.
_INSIDE = 1e-7

# An entry that is given exactly has no halfwidth to count changes in; this share of it, or of its
# size in the robot's units, takes the place.
_SHARE = 1e-3
_SMALL = 1e-6

# Equations that are this close to dependent are, and what moves less along them is fixed.
_DEPENDENT = 1e-11

# Clarabel's, tried in turn until the solver's own account of its errors is no more than this: where
# changes are a million halfwidths it stops early with some of them.
_REGULARIZATIONS = (1e-8, 1e-10, 1e-12, 1e-6)
_ACCURATE = 1e-8

# Masses of scales, kg: beyond, they are no sizes.
_MASSES = (1e-2, 1e3)

# Radius of gyration, as a share of the robot's length, of the bodies that are used as sizes.
_GYRATION = 0.5

# Digits of the weights of a proof, those of a double; and the share of the largest weight below
# which one is a solver's rounding. Tried from 1e-4 to 1e-14 on the tables of the Denso paper: from
# 1e-8 on the proofs reach what the program found.
_DIGITS = 15
_NOTHING = 1e-10

# Rounding of the matrices that follow from weights, as a share of their largest entry.
_TINY = 1e-14


class FoundBodies(NamedTuple):
    """Parameters theta (p,); multipliers of rows (r,) in their units, and of masses (links,)."""

    theta: Array
    rows: Array
    masses: Array


class ScaledQuestion:
    """A question as arrays in units in which its numbers are of order one.

    Parameters
    ----------
    question : Question
        The table and the constraints.
    length : float
        Of the robot, m.

    Attributes
    ----------
    R : ndarray, shape (r, p)
        Rows.
    value, half : ndarray, shape (r,)
        The box.
    give : ndarray, shape (r,)
        The unit in which changes of entries count: halfwidths where there are.
    size : ndarray, shape (r,)
        Size of each row for bodies of the scaling.
    scaling : Scaling
        Sizes of the bodies.
    """

    def __init__(self, question: Question, length: float) -> None:
        q, first = question, 10 * question.n_links
        self.question = question
        self.R = np.zeros((len(q.rows), len(q.theta_names)))
        for k, row in enumerate(q.rows):
            self.R[k, list(row)] = list(map(float, row.values()))
        self.value = np.array(q.values, dtype=float)
        self.half = np.array(q.halfwidths, dtype=float)
        lengths = np.tile([1.0, *(length,) * 3, *(length**2,) * 6], q.n_links)
        unit = np.abs(self.R[:, :first] * lengths).max(axis=1, initial=0.0)
        of_links = unit > 0.0
        implied = (np.abs(self.value) + self.half)[of_links] / unit[of_links]
        mass = float(np.sqrt(np.mean(implied**2))) if implied.size else 1.0
        low, high = max(_MASSES[0], float(q.mass_min)), min(_MASSES[1], float(q.mass_max))
        mass = float(np.clip(mass, low, high))
        sphere = from_pseudo_inertia(mass * np.diag([(_GYRATION * length) ** 2] * 3 + [1.0]))
        # Numbers of friction alone are their own size, and that of the parameters they are about.
        own = np.maximum(np.abs(self.value), np.maximum(self.half, _SMALL))
        self.size = np.where(of_links, mass * unit, own)
        friction = np.ones(self.R.shape[1] - first)
        for k in np.flatnonzero(~of_links).tolist():
            friction[self.R[k, first:] != 0.0] = own[k]
        least = np.maximum(_SHARE * np.abs(self.value), _SMALL * self.size)
        self.give = np.where(self.half > 0.0, self.half, least)
        self.scaling = Scaling(length, mass, np.tile(sphere, (q.n_links, 1)), friction, 1.0)

    def beyond(self, theta: Array) -> Array:
        """Return by how much each number (r,) of theta is above its box, negative below it."""
        off = self.R @ theta - self.value
        return np.asarray(off - np.clip(off, -self.half, self.half))

    def solve(self, changes: Array | None = None) -> FoundBodies | None:
        """Return theta in the box with the largest margin, or with the smallest changes.

        Parameters
        ----------
        changes : ndarray, shape (r, k), optional
            What each of k changes moves the rows by at most, beyond their box. Their sum is the
            smallest for which there is theta with the margin that is asked for.

        Returns
        -------
        FoundBodies or None
            None where there is no such theta.
        """
        from scipy.linalg import null_space

        q, scaling, inner = self.question, self.scaling, changes is None
        links, count = q.n_links, len(q.theta_names)
        rows, value = self.R / self.size[:, None], self.value / self.size
        half = self.half / self.size * (1.0 - inner * _INSIDE)
        moved = np.zeros((len(rows), 1)) if changes is None else changes / self.size[:, None]
        # Exact numbers are equations: as pairs of inequalities they would leave no interior.
        exact = (half == 0.0) & inner
        E = (rows * exact[:, None]) @ scaling.basis()
        origin = scaling.basis() @ np.linalg.lstsq(E, value * exact, rcond=_DEPENDENT)[0]
        along = null_space(E, rcond=_DEPENDENT)
        along[np.abs(along) < _DEPENDENT] = 0.0
        basis = scaling.basis() @ along
        n, more = basis.shape[1], moved.shape[1]
        # The variables: theta along the equations, and then the margin beyond the one asked for,
        # or the changes.
        most = np.full(count, (1.0 - _INSIDE) * float(q.theta_max))
        least, room = -most, _INSIDE * float(q.mass_max - q.mass_min)
        least[: 10 * links : 10] = float(q.mass_min) + room
        most[: 10 * links : 10] = float(q.mass_max) - room
        least[list(q.nonnegative)] = 0.0
        body = scaling.mass * scaling.length**2
        none, first = np.full(len(rows), np.inf), np.full(more, -np.inf if inner else 0.0)
        functions = np.vstack([rows, rows, np.diag(1.0 / scaling.theta), np.zeros((more, count))])
        extra = np.vstack([moved, -moved, np.zeros((count, more)), np.eye(more)])
        lower = np.concatenate([value - half, -none, least / scaling.theta, first])
        upper = np.concatenate([none, value + half, most / scaling.theta, np.full(more, np.inf)])
        here, C = functions @ origin, np.hstack([functions @ basis, extra])
        # What the equations hold fixed is left to the check of what is found.
        moves = np.abs(C).max(axis=1) > _DEPENDENT
        shift = margin_shift(q.consistency)
        roots = np.asarray(np.linalg.inv(scaling.roots(len(shift))))
        units = congruent(roots[:, None], matrix_basis(q.consistency))
        less = congruent(roots, shift)
        linear = np.einsum("lka,lkij->laij", basis[: 10 * links].reshape(links, 10, n), units)
        linear = np.concatenate([linear, -inner * body * less[:, None]], axis=1)
        constants = np.einsum("lk,lkij->lij", origin[: 10 * links].reshape(links, 10), units)
        constants -= float(q.margin) * less
        program = ConicProgram(
            M=np.zeros((0, n + more)),
            m=np.zeros(0),
            cost=np.append(np.zeros(n), -1.0 if inner else np.ones(more)),
            C=C[moves],
            lower=(lower - here)[moves],
            upper=(upper - here)[moves],
            blocks=tuple(map(Matrix, [np.arange(n + 1)] * links, linear, constants)),
        )

        def judged(x: Array, found: ConicSolution) -> tuple[ConicSolution, float] | None:
            # The solver's account of its errors may be smaller than they are: bodies show them.
            bodies = (origin + basis @ x[:n])[: 10 * links].reshape(links, 10)
            least = float(np.min(margin(bodies, q.consistency))) - float(q.margin)
            off = abs(x[n] - least / body) if inner else 0.0
            return None if "Infeasible" in found.status else (found, max(found.error, off))

        solution = solve_with_retries(
            lambda regularization: solve_conic(program, regularization=regularization),
            _REGULARIZATIONS,
            judged,
            enough=_ACCURATE,
        ).value
        if solution is None or solution.x is None:
            return None
        pulls = np.zeros(len(C))
        pulls[moves] = solution.rows
        # The equations' own are what a stationary point has left.
        left = -pulls @ functions
        left[: 10 * links] -= np.einsum("lkij,lij->lk", units, np.array(solution.blocks)).ravel()
        of_exact = np.linalg.lstsq(E.T, scaling.basis().T @ left)[0]
        above, below, bounds, _ = np.split(pulls, np.cumsum([len(rows), len(rows), count]))
        masses = np.maximum(-bounds / scaling.theta, 0.0)[: 10 * links : 10]
        theta = origin + basis @ solution.x[:n]
        return FoundBodies(theta, above + below + of_exact, masses)

    def refutation(
        self, found: FoundBodies | None, digits: int = _DIGITS, *, mass_bound: bool = True
    ) -> StoredRefutation | None:
        """Return the inequality that multipliers make, in rationals; None where there are none.

        What rounding takes off its matrices is added to their diagonals, at the cost of the bound
        on masses or of `theta_max`.
        """
        if found is None or not found.rows.any():
            return None
        q, share = self.question, np.abs(found.rows)
        order = np.argsort(-share, kind="stable")
        used = order[share[order] > _NOTHING * share.max()]
        weights = -found.rows / self.size
        scale = float(np.abs(weights[used]).max())
        proof = StoredRefutation(
            question=q,
            weights={q.names[k]: Fraction(f"{weights[k] / scale:.{digits}g}") for k in used},
        )
        masses, slack = {}, {}
        for link, multiplier in enumerate(found.masses.tolist()):
            if all(map(positive_semidefinite, proof.matrices(link))):
                continue
            if mass_bound and multiplier > 0.0:
                masses[link] = rounded(Fraction(multiplier / scale), _DIGITS, up=True)
            matrices = replace(proof, masses=masses).matrices(link)
            doubles = [np.array(matrix, dtype=float) for matrix in matrices]
            lowest = min(float(np.linalg.eigvalsh(each)[0]) for each in doubles)
            rounding = _TINY * max(float(np.abs(each).max()) for each in doubles)
            if lowest < rounding:
                less = Fraction(max(-lowest, 0.0) + 2.0 * rounding)
                slack[link] = rounded(less, 3, up=True)
        return replace(proof, masses=masses, slack=slack)

    def made_exact(self, theta: Array) -> list[Fraction]:
        """Return theta, which is in the box but for rounding, as rationals within it."""
        q, out = self.question, list(map(Fraction, theta.tolist()))
        for j in range(0, 10 * q.n_links, 10):
            out[j] = min(max(out[j], q.mass_min), q.mass_max)
        for j in q.nonnegative:
            out[j] = max(out[j], Fraction(0))
        # Each row is met by a parameter that no row before it has: short rows go first.
        taken: set[int] = set()
        for k in sorted(range(len(q.rows)), key=lambda k: len(q.rows[k])):
            row, value, half = q.rows[k], q.values[k], q.halfwidths[k]
            own = max(row.keys() - taken, key=lambda j: abs(row[j]), default=None)
            taken.update(row)
            miss = sum((x * out[j] for j, x in row.items()), -value)
            if own is not None and row[own] and abs(miss) > half:
                inside = half * (1 - Fraction(_INSIDE))
                out[own] -= (miss - inside if miss > 0 else miss + inside) / row[own]
        return out
