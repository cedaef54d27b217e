"""Cone programs that look for witnesses, and for the smallest change of a table.

Everything here is in floating point and only proposes; `sdpid.assurance.tables.witness` decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.witness import Question, rational
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import (
    from_pseudo_inertia,
    margin,
    margin_shift,
    matrix_basis,
)

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

    def most_interior(self) -> Array | None:
        """Return theta in the box with the largest margin, None where there is none."""
        lower, upper = self._box()
        found = self._theta_program(
            np.zeros((len(self.R), 0)), lower, upper, gains_margin=True, cost=np.zeros(0)
        )
        return None if found is None else found[0]

    def smallest_changes(self, *, each: bool) -> tuple[Array, Array] | None:
        """Return (theta, changes beyond the box), the smallest for which theta exists.

        Parameters
        ----------
        each : bool
            Minimize the sum over the entries of what each one changes by, in units of `give`,
            instead of the largest.
        """
        count = len(self.R)
        extra = np.diag(self.give) if each else self.give[:, None]
        cost = np.ones(count if each else 1)
        found = self._theta_program(
            extra, self.value - self.half, self.value + self.half, gains_margin=False, cost=cost
        )
        if found is None:
            return None
        theta = found[0]
        beyond = np.maximum(np.abs(self.R @ theta - self.value) - self.half, 0.0)
        return theta, beyond

    def _box(self) -> tuple[Array, Array]:
        half = (1.0 - _INSIDE) * self.half
        return self.value - half, self.value + half

    def _theta_program(
        self, extra: Array, lower: Array, upper: Array, *, gains_margin: bool, cost: Array
    ) -> tuple[Array, Array] | None:
        """Solve over (x, e, t): rows within the box but for ``extra·e``, margins at least t."""
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
        add(rows, extra / size[:, None], lower / size, none)
        add(rows, -extra / size[:, None], -none, upper / size)
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
        low.append(np.append(np.zeros(more), -np.inf if gains_margin else 0.0))
        top = float(q.theta_max) / body if gains_margin else 0.0
        high.append(np.append(np.full(more, np.inf), top))
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
            cost=np.concatenate([np.zeros(n), cost, [-1.0 if gains_margin else 0.0]]),
            C=np.vstack(C),
            lower=np.concatenate(low),
            upper=np.concatenate(high),
            blocks=tuple(blocks),
        )
        if more:
            x = _solved(program)
        else:
            known = np.flatnonzero(self.half == 0.0)
            E = np.hstack([rows[known], np.zeros((len(known), width - n))])
            x = _solved_along(program, E, (self.value / size)[known])
        return None if x is None else (basis @ x[:n], x[n:])

    def margins(self, theta: Array) -> Array:
        """Return every link's margin, NaN where the mass is not positive."""
        bodies = theta[: 10 * self.question.n_links].reshape(-1, 10)
        return margin(bodies, self.question.consistency)

    def made_exact(self, theta: Array) -> list[Fraction]:
        """Return theta, which is in the box but for rounding, as rationals within it."""
        q, out = self.question, rational(theta)
        for j in range(0, 10 * q.n_links, 10):
            out[j] = min(max(out[j], q.mass_min), q.mass_max)
        for j in q.nonnegative:
            out[j] = max(out[j], Fraction(0))
        # Rows that are one standard parameter first: base parameters make up for them.
        order = sorted(range(len(q.rows)), key=lambda k: len(q.rows[k]) > 1)
        for k in order:
            row, value, half, column = q.rows[k], q.values[k], q.halfwidths[k], q.leading[k]
            miss = sum((x * out[j] for j, x in row.items()), -value)
            if column is not None and abs(miss) > half:
                inside = half * (1 - Fraction(_INSIDE))
                out[column] -= (miss - inside if miss > 0 else miss + inside) / row[column]
        return out


def _solved(program: ConicProgram) -> Array | None:
    """Return the solution of a program, None where there is none."""
    solution = solve_conic(program)
    return None if solution.x is None or "Infeasible" in solution.status else solution.x


def _solved_along(program: ConicProgram, E: Array, target: Array) -> Array | None:
    """Return the solution of a program along equations that its inequalities contain.

    As pairs of inequalities they would leave it no interior, and solvers need one.
    """
    if not len(E):
        return _solved(program)
    U, singular, V = np.linalg.svd(E)
    rank = int(np.count_nonzero(singular > _DEPENDENT * singular.max()))
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
    z = _solved(
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
    return None if z is None else origin + along @ z
