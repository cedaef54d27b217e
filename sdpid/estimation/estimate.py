"""What a solver hands back, with everything that can be recomputed recomputed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.estimation.agreement.agreement import Agreement
from sdpid.estimation.agreement.compare import compare_estimates
from sdpid.estimation.duality.bound import Bound, Multipliers
from sdpid.estimation.duality.refine_multipliers import lower_bound
from sdpid.estimation.information import require_excitation
from sdpid.estimation.posterior import Estimated, Posterior
from sdpid.estimation.problem import Problem
from sdpid.robot.model.dynamics import RobotDynamics

Status = Literal["optimal", "infeasible", "iteration limit", "stalled", "failed", "given"]

Kind = TypeVar("Kind", bound="Estimate")

# A point this far outside a constraint (kg·m², kg, …) counts as feasible: rounding of its own.
FEASIBLE = 1e-9


@dataclass(frozen=True)
class Step:
    """One iteration of a local solver: seconds since its start, cost, worst violation."""

    seconds: float
    cost: float
    violation: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimate(Estimated):
    """Estimated parameters and how they came about.

    Attributes
    ----------
    problem : Problem
        What was solved.
    method : str
        ``"wls"``, ``"slsqp"``, ``"log_cholesky"`` or ``"sdp"``; ``"given"`` for parameters that
        were found elsewhere.
    base : ndarray, shape (b,)
        Base parameters, in the units of ``problem.base.units``.
    theta : ndarray, shape (p,), or None
        Standard parameters; None where the method has none.
    status : str
        ``"optimal"`` or what went wrong: ``"infeasible"``, ``"iteration limit"``, ``"stalled"``
        or ``"failed"``; ``"given"`` for parameters that no solver found.
    message : str
        What the solver said, in words.
    iterations : int
        Iterations of the solver.
    solve_time : float
        Seconds in the solver.
    multipliers : Multipliers or None
        Where the method has them.
    history : tuple of Step
        Cost and violation over the iterations, for solvers that show them.
    start : ndarray or None
        Standard parameters that a local solver started from.
    curvature : ndarray, shape (r, r), or None
        Half the second derivative of the data's cost, along the columns of
        ``problem.excitation.root``, where it is not that of the problem's squares.

    Examples
    --------
    >>> estimate.status, estimate.feasible, estimate.theta.shape, estimate.base.shape
    ('optimal', True, (72,), (48,))
    >>> fv1 = problem.base.names.index("Fv1")
    >>> value, error = estimate.base[fv1], estimate.standard_errors[fv1]
    >>> f"{value:.0f} ± {2.0 * error:.1f} {problem.base.units[fv1]}"
    '151 ± 0.1 N.m.s/rad'
    >>> estimate.mass_matrix(np.zeros(6)).shape
    (6, 6)
    >>> estimate.model()
    RobotDynamics('denso_vp6242', 6 coordinates, terms: Coulomb, Viscous)
    """

    status: Status
    message: str = ""
    iterations: int = 0
    solve_time: float = 0.0
    multipliers: Multipliers | None = None
    history: tuple[Step, ...] = field(default=(), repr=False)
    start: Array | None = field(default=None, repr=False)

    _facts = (
        "problem.robot.name",
        "method",
        "status",
        "cost",
        "worst_margin, kg·m²",
        "iterations",
        "solve_time, s",
    )

    @classmethod
    def of_theta(cls, problem: Problem, theta: ArrayLike, **fields: Any) -> Estimate:
        """Build from standard parameters."""
        values = frozen(theta)
        return cls(problem=problem, base=frozen(problem.base_of(values)), theta=values, **fields)

    def _tables(self) -> Iterator[Table]:
        base = self.problem.base
        yield Table.of_columns(
            {"base parameter": base.names, "unit": base.units, "value": self.base.tolist()}
        )

    @cached_property
    def cost(self) -> float:
        """Weighted cost, recomputed; with a prior the prior's part included."""
        if self.problem.prior is None or self.theta is None:
            return self.problem.cost(self.base)
        return self.problem.cost_of(self.theta)

    @cached_property
    def margins(self) -> tuple[float | None, ...] | None:
        """Margin of each link, kg·m², under the problem's consistency; None where m ≤ 0.

        None altogether where the method has no standard parameters.
        """
        if self.theta is None:
            return None
        found = self.problem.feasible.margins(self.theta)
        return tuple(float(each) if np.isfinite(each) else None for each in found)

    @property
    def worst_margin(self) -> float | None:
        """The smallest margin, None where a link has none."""
        found = [each for each in self.margins or () if each is not None]
        return min(found) if self.margins and len(found) == len(self.margins) else None

    @cached_property
    def violation(self) -> float | None:
        """By how much the worst constraint is violated; 0 when feasible, None without theta."""
        return None if self.theta is None else self.problem.feasible.violation(self.theta)

    @property
    def feasible(self) -> bool:
        """Whether the standard parameters satisfy every constraint."""
        return self.violation is not None and self.violation <= FEASIBLE

    @property
    def some_theta(self) -> Array:
        """Standard parameters with these base parameters: `theta`, or else the smallest, (p,)."""
        if self.theta is not None:
            return self.theta
        return frozen(np.linalg.pinv(self.problem.base.matrix) @ self.base)

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix at joint positions.

        Base parameters determine it, so an estimate without standard parameters has one too.

        Parameters
        ----------
        q : array_like, shape (n,) or (K, n)
            Joint positions, rad or m.

        Returns
        -------
        ndarray, shape (n, n) or (K, n, n)
        """
        return self.problem.robot.mass_matrix(self.some_theta, q)

    def model(self) -> RobotDynamics:
        """Return the identified robot, to compute with: inverse and forward dynamics, friction.

        Of an estimate without standard parameters the links are any that have its base
        parameters: efforts are right, and need not be those of bodies.
        """
        problem = self.problem
        theta = self.some_theta
        if self.theta is None:
            theta = frozen(_with_masses(problem, theta))
        return RobotDynamics(robot=problem.robot, terms=problem.friction, theta=theta)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the base parameters, (b, b): that of the Gauss-Markov intervals.

        The errors that the residuals' spectrum shows, those of a prior as stated, and what else is
        known to move the fit (see `sdpid.estimation.posterior`). Inequalities are not counted,
        equations among the constraints are. Infinite on the diagonal is what neither data nor a
        prior see.

        Raises
        ------
        DataError
            When the problem has no rows.
        IdentifiabilityError
            When there is no prior, and the data leave base parameters undetermined.
        """
        if self.problem.prior is None:
            require_excitation(self.problem.excitation)
        posterior, functions = Posterior.of(self), self.problem.base.matrix
        found, lost = posterior.covariance(functions), posterior.lost(functions)
        found[lost, lost] = np.inf
        return frozen(found)

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors of the base parameters, (b,), from `covariance`."""
        return frozen(np.sqrt(np.diag(self.covariance)))

    @property
    def proof(self) -> Multipliers:
        """Multipliers that a lower bound on the cost starts from.

        The method's own; where it has none, the residual alone, which ignores the constraints.
        """
        if self.multipliers is not None:
            return self.multipliers
        if self.theta is not None:
            return Multipliers.at(self.problem, np.array(self.theta))
        y = self.problem.A @ self.base - self.problem.rhs
        return Multipliers.of_cost(self.problem, y)

    def bound(self, *, exhaustive: bool = False) -> Bound:
        """Return what `proof` proves of the cost of all feasible parameters.

        Parameters
        ----------
        exhaustive : bool, optional
            Refine the multipliers as far as they go.
        """
        theta = None if self.theta is None else np.array(self.theta)
        return lower_bound(self.problem, theta, self.proof, self.cost, exhaustive=exhaustive)

    def to_frame(self, parameters: Literal["base", "standard"] = "base") -> Any:
        """Return parameters as a pandas DataFrame, one row each.

        Parameters
        ----------
        parameters : {"base", "standard"}, optional
            Base parameters with ``unit``, ``value``, ``standard_error``
            (missing where the problem has no rows) and ``regrouping``; or standard parameters with
            ``unit`` and ``value``.

        Raises
        ------
        DataError
            For other words, or standard parameters of a method that has none.
        """
        base = self.problem.base
        columns: dict[str, Any]
        if parameters == "standard" and self.theta is not None:
            names, columns = base.theta_names, {"unit": base.theta_units, "value": self.theta}
        elif parameters == "base":
            names, columns = base.names, {"unit": base.units, "value": self.base}
            sized = self.problem.rows is not None
            columns["standard_error"] = self.standard_errors if sized else np.nan
            columns["regrouping"] = [base.expression(name) for name in base.names]
        elif parameters == "standard":
            raise DataError(
                f"to_frame: method '{self.method}' gives no standard parameters; use an estimate "
                "of a constrained solver."
            )
        else:
            raise DataError(f"to_frame: parameters is {parameters!r}: use 'base' or 'standard'.")
        import pandas

        return pandas.DataFrame(columns, index=pandas.Index(names, name="name"))

    def compare_to(
        self, other: Any, *, level: float = 0.95, independent: bool | None = None
    ) -> Agreement:
        """Test whether another estimate of the same robot differs by more than both errors.

        Parameters
        ----------
        other : Estimate or Identification
            Of the same joints and links: of another log, after a repair or with a payload, or of
            other friction terms. Compared are the base parameters that both have.
        level : float, optional
            Of the intervals and of the test.
        independent : bool, optional
            Whether the errors of the data are independent. By default they are unless both used
            samples of the same recording, which is seen where it was processed alike; say False
            where it was processed in two ways.

        Returns
        -------
        Agreement
            Differences (`other` less this) against their intervals, one test of all together, and
            what the predicted efforts differ by; ``.table()``, ``.to_frame()``.

        Raises
        ------
        DataError
            When the robots differ, or a problem has no rows.
        """
        other = getattr(other, "estimate", other)
        if not isinstance(other, Estimate):
            raise DataError(
                f"compare_to: other is {type(other).__name__} {other!r:.60}; give an Estimate, "
                "such as result.estimate."
            )
        return compare_estimates(self, other, level=level, independent=independent)

    def named(self) -> dict[str, float]:
        """Return base parameters by name."""
        return dict(zip(self.problem.base.names, self.base.tolist(), strict=True))

    def named_theta(self) -> dict[str, float] | None:
        """Return standard parameters by name, None where the method has none."""
        if self.theta is None:
            return None
        return dict(zip(self.problem.base.theta_names, self.theta.tolist(), strict=True))


def extended(kind: type[Kind], found: Estimate, **more: Any) -> Kind:
    """Return an estimate as one of a kind that says more, with other or further attributes."""
    return kind(**{**{each.name: getattr(found, each.name) for each in fields(Estimate)}, **more})


def _with_masses(problem: Problem, theta: Array) -> Array:
    """Return the standard parameters with the same base parameters whose masses are nearest 1 kg.

    Pinocchio's bodies have centers of mass, and so need a mass.
    """
    from scipy.linalg import null_space

    free = null_space(problem.base.matrix)
    masses = 10 * np.arange(problem.robot.n_links)
    moves = np.linalg.lstsq(free[masses], 1.0 - theta[masses], rcond=None)[0]
    return np.asarray(theta + free @ moves)
