"""Cone programs that look for witnesses, and for the smallest change of a table.

Everything here is in floating point and only proposes; `sdpid.assurance.tables.witness` decides.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.witness import Question, rational
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

# Gap and residuals at which the solver stops.
_TOLERANCE = 1e-10

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
        What is asked.
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
        import cvxpy as cp

        gain, x = cp.Variable(), cp.Variable(self.R.shape[1])
        error, half = self._errors(x), (1.0 - _INSIDE) * self.half / self._size
        exact = self.half == 0.0
        inside = [cp.abs(error[~exact]) <= half[~exact], error[exact] == 0.0]
        # A margin beyond theta_max makes no sense.
        inside.append(gain <= float(self.question.theta_max) / self._body)
        if not solved(cp.Maximize(gain), [*inside, *self._links(x, gain)]):
            return None
        return np.asarray(self.scaling.basis() @ x.value)

    def smallest_changes(self, *, each: bool) -> tuple[Array, Array] | None:
        """Return (theta, changes beyond the box), the smallest for which theta exists.

        Parameters
        ----------
        each : bool
            Minimize the sum over the entries of what each one changes by, in units of `give`,
            instead of the largest.
        """
        import cvxpy as cp

        x = cp.Variable(self.R.shape[1])
        changes = cp.Variable(len(self.R) if each else 1, nonneg=True)
        beyond = cp.multiply(self.give / self._size, changes)
        inside = [cp.abs(self._errors(x)) <= self.half / self._size + beyond]
        if not solved(cp.Minimize(cp.sum(changes)), [*inside, *self._links(x, 0.0)]):
            return None
        theta = np.asarray(self.scaling.basis() @ x.value)
        return theta, np.maximum(np.abs(self.R @ theta - self.value) - self.half, 0.0)

    @property
    def _size(self) -> Array:
        """The unit of each row."""
        return np.asarray(self.scaling.mass * self.unit)

    @property
    def _body(self) -> float:
        """The unit of margins, kg·m²."""
        return self.scaling.mass * self.scaling.length**2

    def _errors(self, x: Any) -> Any:
        """Return what the rows miss the values by, for scaled parameters x, in units of order 1."""
        size = self._size
        return (self.R @ self.scaling.basis() / size[:, None]) @ x - self.value / size

    def _links(self, x: Any, gain: Any) -> list[Any]:
        """Return the constraints on scaled parameters x, margins `gain` above the one asked for."""
        import cvxpy as cp

        q, scaling = self.question, self.scaling
        basis = scaling.basis()
        upper = np.full(len(basis), (1.0 - _INSIDE) * float(q.theta_max))
        lower = -upper
        room = _INSIDE * float(q.mass_max - q.mass_min)
        lower[: 10 * q.n_links : 10] = float(q.mass_min) + room
        upper[: 10 * q.n_links : 10] = float(q.mass_max) - room
        lower[sorted(q.nonnegative)] = 0.0
        theta = (basis / scaling.theta[:, None]) @ x
        out = [theta >= lower / scaling.theta, theta <= upper / scaling.theta]
        units, shift = matrix_basis(q.consistency), margin_shift(q.consistency)
        for link, root in enumerate(np.linalg.inv(scaling.roots(len(shift)))):
            own = slice(10 * link, 10 * link + 10)
            linear = np.einsum("ka,kij->ija", basis[own, own], root @ units @ root.T)
            shifted = root @ shift @ root.T
            matrix = cp.reshape(linear.reshape(-1, 10) @ x[own], shift.shape, order="C")
            out.append(matrix - (self._body * gain + float(q.margin)) * shifted >> 0)
        return out

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


def solved(objective: Any, constraints: list[Any]) -> bool:
    """Solve a CVXPY problem; return whether its variables have values, accurate or not."""
    import cvxpy as cp

    program = cp.Problem(objective, constraints)
    limits = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), _TOLERANCE)
    with warnings.catch_warnings():
        # What is found is checked in exact arithmetic: it need not be accurate.
        warnings.simplefilter("ignore")
        try:
            # Numbers are of order one as they are: scaled again they lose digits.
            program.solve(solver=cp.CLARABEL, equilibrate_enable=False, **limits)
        except cp.error.SolverError:
            return False
    return all(variable.value is not None for variable in program.variables())
