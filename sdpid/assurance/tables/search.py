"""Cone programs that look for witnesses and for the smallest change of a table, with their duals.

Everything here is in floating point and only proposes. Multipliers of a program's rows are the
weights of an inequality that all bodies obey: rounded to rationals they are a proof, which
`sdpid.verifier.realizable` decides, whatever the solver says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.answers import Refutation
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import (
    from_pseudo_inertia,
    margin,
    margin_shift,
    matrix_basis,
)
from sdpid.verifier.decimals import rounded
from sdpid.verifier.exact import positive_semidefinite
from sdpid.verifier.realizable import ExactMatrix, Question, coefficient_matrices

# Witnesses keep this share of its width away from the ends of the box, and of the bounds, so that
# rounding does not carry them out of it.
_INSIDE = 1e-7

# An entry that is given exactly has no halfwidth to count changes in; this share of it, or of its
# size in the robot's units, takes the place.
_SHARE = 1e-3
_SMALL = 1e-6

# Equations that are this close to dependent are.
_DEPENDENT = 1e-11

# Masses of scales, kg: beyond, they are no sizes.
_MASSES = (1e-2, 1e3)

# Radius of gyration, as a share of the robot's length, of the bodies that are used as sizes.
_GYRATION = 0.5

# Digits of the weights of a proof, those of a double; and the share of the largest weight below
# which one is a solver's rounding. Tried from 1e-4 to 1e-14 on the tables of the Denso paper: from
# 1e-8 on the proofs reach what the program found.
DIGITS = 15
_NOTHING = 1e-10

# Rounding of the matrices that follow from weights, as a share of their largest entry.
_TINY = 1e-14


@dataclass(frozen=True, eq=False)
class Found:
    """What a program found.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        Standard parameters.
    beyond : ndarray, shape (r,)
        By how much each of the table's numbers is off beyond its halfwidth.
    rows : ndarray, shape (r,)
        Multipliers of the table's numbers, in units of their rows.
    masses : ndarray, shape (links,)
        Multipliers of the upper bound on masses.
    """

    theta: Array
    beyond: Array
    rows: Array
    masses: Array


@dataclass(frozen=True, eq=False)
class Search:
    """A question as arrays in units in which its numbers are of order one.

    Attributes
    ----------
    question : Question
        The table and the constraints.
    R : ndarray, shape (r, p)
        Rows.
    value, half : ndarray, shape (r,)
        The box.
    unit : ndarray, shape (r,)
        Size of each row for bodies of one kg.
    give : ndarray, shape (r,)
        The unit in which changes of entries count: halfwidths where there are.
    scaling : Scaling
        Sizes of the bodies.
    """

    question: Question
    R: Array
    value: Array
    half: Array
    unit: Array
    give: Array
    scaling: Scaling

    @classmethod
    def of(cls, question: Question, length: float) -> Search:
        """Build for a robot of some length (m)."""
        count, links = len(question.theta_names), question.n_links
        R = np.zeros((len(question.rows), count))
        for k, row in enumerate(question.rows):
            for j, x in row.items():
                R[k, j] = float(x)
        value = np.array([float(x) for x in question.values])
        half = np.array([float(x) for x in question.halfwidths])
        sizes = np.tile([1.0, *(length,) * 3, *(length**2,) * 6], links)
        inertial = np.abs(R[:, : 10 * links]) * sizes
        unit = inertial.max(axis=1, initial=0.0)
        of_links = unit > 0.0
        implied = (np.abs(value) + half)[of_links] / unit[of_links]
        mass = float(np.sqrt(np.mean(implied**2))) if implied.size else 1.0
        low, high = max(_MASSES[0], float(question.mass_min)), _MASSES[1]
        mass = float(np.clip(mass, low, min(high, float(question.mass_max))))
        sphere = from_pseudo_inertia(mass * np.diag([(_GYRATION * length) ** 2] * 3 + [1.0]))
        friction = np.ones(count - 10 * links)
        size = np.maximum(np.abs(value), np.maximum(half, _SMALL))
        for k in np.flatnonzero(~of_links).tolist():
            touched = np.flatnonzero(R[k, 10 * links :])
            friction[touched] = size[k]
            unit[k] = size[k] / mass
        give = np.where(half > 0.0, half, np.maximum(_SHARE * np.abs(value), _SMALL * mass * unit))
        scaling = Scaling(length, mass, np.tile(sphere, (links, 1)), friction, 1.0)
        return cls(question, R, value, half, unit, give, scaling)

    def most_interior(self) -> Found | None:
        """Return theta in the box with the largest margin, None where there is none."""
        half = (1.0 - _INSIDE) * self.half
        return self._solved(np.zeros((len(self.R), 0)), half, np.zeros(0))

    def smallest_changes(self, *, each: bool) -> Found | None:
        """Return the smallest changes beyond the box for which theta exists.

        Parameters
        ----------
        each : bool
            Minimize the sum over the entries of what each one changes by, in units of `give`,
            instead of the largest.
        """
        extra = np.diag(self.give) if each else self.give[:, None]
        return self._solved(extra, self.half, np.ones(extra.shape[1]))

    def with_any_mass(self) -> Search:
        """Return the search with masses bounded by `theta_max` alone."""
        q = self.question
        return replace(self, question=replace(q, mass_max=q.theta_max))

    def _solved(self, extra: Array, half: Array, cost: Array) -> Found | None:
        """Solve over (x, e, t): rows within the box but for ``extra·e``, margins at least t.

        Without extra columns the margin is the largest that there is, else the one asked for.
        """
        q, scaling = self.question, self.scaling
        basis = scaling.basis()
        n, more = basis.shape[1], extra.shape[1]
        width = n + more + 1
        size = scaling.mass * self.unit
        body = scaling.mass * scaling.length**2
        start = float(q.margin)
        C, low, high = [], [], []

        def add(rows: Array, extras: Array, below: Array, above: Array) -> None:
            C.append(np.hstack([rows, extras, np.zeros((len(rows), 1))]))
            low.append(below)
            high.append(above)

        rows = self.R @ basis / size[:, None]
        none = np.full(len(rows), np.inf)
        add(rows, extra / size[:, None], (self.value - half) / size, none)
        add(rows, -extra / size[:, None], -none, (self.value + half) / size)
        bounded = np.full(n, (1.0 - _INSIDE) * float(q.theta_max))
        floor = -bounded.copy()
        room = _INSIDE * float(q.mass_max - q.mass_min)
        floor[: 10 * q.n_links : 10] = float(q.mass_min) + room
        bounded[: 10 * q.n_links : 10] = float(q.mass_max) - room
        floor[sorted(q.nonnegative)] = 0.0
        add(
            basis / scaling.theta[:, None],
            np.zeros((n, more)),
            floor / scaling.theta,
            bounded / scaling.theta,
        )
        last = np.zeros((more + 1, width))
        last[:, n:] = np.eye(more + 1)
        C.append(last)
        # The margin is counted from the one that is asked for, and not beyond all sense.
        low.append(np.append(np.zeros(more), 0.0 if more else -np.inf))
        high.append(np.append(np.full(more, np.inf), 0.0 if more else float(q.theta_max) / body))
        units, shift = matrix_basis(q.consistency), margin_shift(q.consistency)
        blocks = []
        for link, root in enumerate(np.linalg.inv(scaling.roots(len(shift)))):
            own = slice(10 * link, 10 * link + 10)
            linear = np.einsum("ka,kij->aij", basis[own, own], root @ units @ root.T)
            shifted = root @ shift @ root.T
            blocks.append(
                Matrix(
                    np.append(np.arange(10 * link, 10 * link + 10), width - 1),
                    np.concatenate([linear, -body * shifted[None]]),
                    -start * shifted,
                )
            )
        program = ConicProgram(
            M=np.zeros((0, width)),
            m=np.zeros(0),
            cost=np.concatenate([np.zeros(n), cost, [0.0 if more else -1.0]]),
            C=np.vstack(C),
            lower=np.concatenate(low),
            upper=np.concatenate(high),
            blocks=tuple(blocks),
        )
        known = np.flatnonzero((self.half == 0.0) & (more == 0))
        E = np.hstack([rows[known], np.zeros((len(known), width - n))])
        found = _solved_along(program, E, (self.value / size)[known])
        if found is None:
            return None
        x, multipliers, of_known = found
        count = len(rows)
        both = multipliers[:count] + multipliers[count : 2 * count]
        both[known] += of_known
        bounds = multipliers[2 * count : 2 * count + 10 * q.n_links : 10]
        masses = np.maximum(-bounds / scaling.theta[: 10 * q.n_links : 10], 0.0)
        theta = basis @ x[:n]
        beyond = np.maximum(np.abs(self.R @ theta - self.value) - self.half, 0.0)
        return Found(theta, beyond, both, masses)

    def refutation(
        self, found: Found, digits: int = DIGITS, *, mass_bound: bool = True
    ) -> Refutation | None:
        """Return the inequality that multipliers make, in rationals; None where they are zero.

        What rounding takes off its matrices is added to their diagonals, at the cost of the bound
        on masses or of `theta_max`.
        """
        q = self.question
        weights = -found.rows / (self.scaling.mass * self.unit)
        order = np.argsort(-np.abs(found.rows), kind="stable")
        used = order[np.abs(found.rows[order]) > _NOTHING * np.abs(found.rows).max()]
        if not used.size:
            return None
        scale = float(np.abs(weights[used]).max())
        proof = Refutation(
            question=q,
            weights={q.names[k]: Fraction(f"{weights[k] / scale:.{digits}g}") for k in used},
        )
        masses, slack = {}, {}
        for link, multiplier in enumerate(found.masses.tolist()):
            if all(map(positive_semidefinite, _matrices(proof, link))):
                continue
            if mass_bound and multiplier > 0.0:
                masses[link] = rounded(Fraction(multiplier / scale), DIGITS, up=True)
            matrices = _matrices(replace(proof, masses=masses), link)
            doubles = [np.array(matrix, dtype=float) for matrix in matrices]
            lowest = min(float(np.linalg.eigvalsh(each)[0]) for each in doubles)
            rounding = _TINY * max(float(np.abs(each).max()) for each in doubles)
            if lowest < rounding:
                less = Fraction(max(-lowest, 0.0) + 2.0 * rounding)
                slack[link] = rounded(less, 3, up=True)
        return replace(proof, masses=masses, slack=slack)

    def margins(self, theta: Array) -> Array:
        """Return every link's margin, NaN where the mass is not positive."""
        bodies = theta[: 10 * self.question.n_links].reshape(-1, 10)
        return margin(bodies, self.question.consistency)

    def made_exact(self, theta: Array) -> list[Fraction]:
        """Return theta, which is in the box but for rounding, as rationals within it."""
        q, out = self.question, [Fraction(float(x)) for x in theta]
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


def _matrices(proof: Refutation, link: int) -> list[ExactMatrix]:
    """Return the matrices of a link that an inequality needs to be positive semidefinite."""
    C, Q = coefficient_matrices(proof.link(link))
    return [C, Q] if proof.question.consistency == "spatial_inertia" else [Q]


def _solved_along(
    program: ConicProgram, E: Array, target: Array
) -> tuple[Array, Array, Array] | None:
    """Solve a program along equations that its inequalities contain; return x and multipliers.

    As pairs of inequalities they would leave it no interior, and solvers need one. Multipliers are
    those of C's rows, and of the equations.
    """
    U, singular, V = np.linalg.svd(E)
    rank = int(np.count_nonzero(singular > _DEPENDENT * singular.max(initial=0.0)))
    origin = V[:rank].T @ ((U[:, :rank].T @ target) / singular[:rank])
    along = V[rank:].T
    along[np.abs(along) < _DEPENDENT] = 0.0
    C = program.C @ along
    # What the equations hold fixed is left to the check of what is found.
    moves = np.abs(C).max(axis=1, initial=0.0) > _DEPENDENT
    fixed = program.C @ origin
    blocks = []
    for block in program.blocks:
        directions = along[block.index]
        index = np.flatnonzero(np.any(directions != 0.0, axis=0))
        linear = np.einsum("ka,kij->aij", directions[:, index], block.linear)
        constant = block.constant + np.einsum("k,kij->ij", origin[block.index], block.linear)
        blocks.append(Matrix(index, linear, constant))
    assert program.cost is not None
    solution = solve_conic(
        ConicProgram(
            M=np.zeros((0, along.shape[1])),
            m=np.zeros(0),
            cost=program.cost @ along,
            C=C[moves],
            lower=(program.lower - fixed)[moves],
            upper=(program.upper - fixed)[moves],
            blocks=tuple(blocks),
        )
    )
    if solution.x is None or "Infeasible" in solution.status:
        return None
    multipliers = np.zeros(len(C))
    multipliers[moves] = solution.rows
    # The equations' own are what a stationary point has left.
    left = program.cost - program.C.T @ multipliers
    for block, Z in zip(program.blocks, solution.blocks, strict=True):
        left[block.index] -= np.einsum("kij,ij->k", block.linear, Z)
    of_equations = np.asarray(np.linalg.lstsq(E.T, left)[0], dtype=float)
    return origin + along @ solution.x, multipliers, of_equations
