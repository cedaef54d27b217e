"""The extremes of linear functions over all feasible parameters whose cost is within a level.

    minimize, maximize c·theta  over feasible theta with ‖G·theta − h‖² ≤ ‖G·theta* − h‖² + rise

One conic program each way; they share everything but the linear cost. What is returned does not
rest on the solver's word: with its multipliers u of the residual, Z of the matrices (made positive
semidefinite) and λ of the rows,

    c·theta ≥ (c − G^T·u − Σ F*(Z) − rows^T·λ)·theta + u·h − ‖u‖·rho − Σ⟨Z, F0⟩ + λ·limits

for every such theta, whatever the multipliers, rho² being the level. The bracket is zero but for
rounding, and what it can amount to is bounded by the box that theta lies in: first the declared
one, then the one of the bounds found so, at the highest of all levels.

**The level** depends on where the extreme is (see `sdpid.assurance.intervals.level`), which is
known when the program is solved: it is solved again where the level changes by much. Among all
values of c·theta that the rule admits the outermost is wanted, so the search comes from above: from
the level at which the fit loses all its degrees of freedom, down to the first that the rule does
not lower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.threads import parallel
from sdpid.assurance.intervals.level import Level
from sdpid.assurance.intervals.parameters import (
    FROM_DATA,
    FROM_PHYSICS,
    FROM_PRIOR,
    ParameterFunctions,
)
from sdpid.errors import DataError, SolverError
from sdpid.estimation.conic.fit_response import FitResponse
from sdpid.estimation.conic.solve import ConicFamily, ConicSolution, solve_conic, solve_with_retries
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.duality.bound import clip_psd
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import FitErrors, Groups, fit_errors
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import SdpProgram

# A level that changes by less than this share is not worth another solve: the multipliers found
# before prove a bound at the new level too, worse by the square of that share.
_SETTLED = 0.1
_ROUNDS = 8

# Nor is a lower level where the multipliers prove a bound this close, in shares of the end's
# distance, to a point between the extreme and the estimate.
_TIGHT = 1e-4

# An extreme that moves by less than this share with the radius is a limit of the constraints.
_FLAT = 1e-4

# Ends that are one job: their levels are found together.
_TOGETHER = 8

# Regularizations, tried until the bound proven is within this share of the point found.
_REGULARIZATIONS = (1e-10, 1e-8, 1e-12)
_CLOSE = 1e-3

# An end that would move by this share, were a limit twice as far, rests on the limit.
_RESTS = 0.01
_AT = 0.999


@dataclass(frozen=True, eq=False)
class End:
    """One end of an interval: the minimum of c·theta (lower end) or of −c·theta (upper end).

    Attributes
    ----------
    theta : ndarray, shape (p,)
        The solver's point; what the function is there is not proven, but attained within rounding.
    u, Z, rows : ndarray
        Multipliers of the residual, the matrices and the linear rows.
    rise : float
        The level, above the estimate's cost.
    solved : float
        The level of that point.
    rests : tuple of bool
        Whether it rests on theta_max, and on the largest mass.
    prior_share : float
        Share of the prior's rows in what holds it.
    seconds : float
        In the solver.
    solves : int
        Programs solved.
    moved : ndarray, shape (r,), or None
        While levels are sought: how the residual moves from the estimate.
    lost : ndarray, shape (r, r), or None
        By how much less the fitted rows move with the data there (see `Level.rises`).
    to_limit : float or None
        Where constraints alone end the function: the rise at which it gets there.
    """

    theta: Array
    u: Array
    Z: Array
    rows: Array
    rise: float
    solved: float
    rests: tuple[bool, bool]
    prior_share: float
    seconds: float = 0.0
    solves: int = 0
    moved: Array | None = None
    lost: Array | None = None
    to_limit: float | None = None


class ProfileLikelihood:
    """Profile likelihood of one estimate: minima of linear functions within a level of the cost.

    Parameters
    ----------
    problem : Problem
        The problem; no log-det prior.
    theta : ndarray, shape (p,)
        The estimate.
    errors : FitErrors
        What is known of the errors.
    level : float
        Of the intervals, such as 0.95.
    """

    def __init__(self, problem: Problem, theta: Array, errors: FitErrors, level: float) -> None:
        if len(problem.log_det.links):
            raise DataError(
                "profile intervals: a log-det prior makes the cost more than squares; use "
                "method='bootstrap'."
            )
        self.problem, self.theta = problem, theta
        self.residual = problem.squared.residual(theta)
        self.cost = float(self.residual @ self.residual)
        self.level = Level(problem, errors, level, self.cost)
        # The size of the level sets, for numbers of order one.
        self.unit = float(np.sqrt(self.cost + self.level.typical))
        scaling = replace(Scaling.of(problem), cost=self.unit**2)
        coordinates = Coordinates.of(problem, scaling.basis(), np.array(theta))
        if coordinates is None:
            raise SolverError(
                "profile intervals: the equations among the constraints contradict each other.",
                problem=problem,
            )
        self.program = SdpProgram.build(
            problem, scaling, coordinates, np.ones(problem.n_theta, dtype=bool)
        )
        conic = self.program.conic
        self.family = ConicFamily(replace(conic, cost=None, radius=1.0))
        self.response = FitResponse(conic)
        pattern = np.vstack([conic.M != 0.0, np.ones((1, conic.n), dtype=bool)])
        self.held = ConicFamily(
            replace(conic, M=pattern * 1.0, m=np.zeros(len(pattern))), pattern=pattern
        )

    @cached_property
    def _free(self) -> Array:
        """The derivative (r, r) of the fitted rows with respect to the data, at the optimum."""
        found = solve_conic(self.program.conic)
        return self.response.at(np.asarray(found.x), found.rows, found.blocks)

    def expected(self, functional: Array) -> Array:
        """Return how the residual moves at the extreme of a function (b,) of the base parameters.

        It is that of the problem without constraints.
        """
        root = self.problem.excitation.root
        moved = np.zeros(len(self.residual))
        moved[: len(root)] = self.problem.A @ root @ (root.T @ functional)
        return moved

    def minima(
        self,
        functions: Array,
        moves: Sequence[Array | None] | None = None,
        n_jobs: int | None = None,
    ) -> list[End]:
        """Return the minimum of each of several linear functions c·theta.

        Parameters
        ----------
        functions : ndarray, shape (k, p)
            The functions.
        moves : sequence of ndarray or None, optional
            How the residual is thought to move, where that is known: for the first levels.
        n_jobs : int, optional
            Jobs (joblib), by default one a core: threads, or the backend of a surrounding
            ``joblib.parallel_config``. The result does not depend on it.

        Raises
        ------
        SolverError
            When the solver finds nothing.
        """
        from joblib import delayed

        moves = moves or [None] * len(functions)
        parts = [slice(i, i + _TOGETHER) for i in range(0, len(functions), _TOGETHER)]
        found = parallel(n_jobs, threads=True)(
            delayed(self._some)(functions[part], moves[part]) for part in parts
        )
        return [end for each in found for end in each]

    def _some(self, functions: Array, moves: Sequence[Array | None]) -> list[End]:
        """Return the minima of a few functions, whose levels are updated together."""
        levels = self.level.highest(moves, float(np.trace(self._free)))
        ends: dict[int, End] = {}
        spent = np.zeros((len(functions), 2))
        left = list(range(len(functions)))
        for _ in range(_ROUNDS):
            found = [self._at(functions[i], levels[i]) for i in left]
            rises = self.level.rises([end.moved for end in found], [end.lost for end in found])
            tried, left = left, []
            for i, end, rise in zip(tried, found, rises, strict=True):
                spent[i] += end.seconds, end.solves
                ends[i], levels[i] = replace(end, rise=rise), rise
                nearer = self._nearer(functions[i], ends[i])
                if nearer is None:
                    left.append(i)
                else:
                    ends[i] = nearer
            if not left:
                break
        return [
            replace(ends[i], seconds=seconds, solves=int(solves), moved=None, lost=None)
            for i, (seconds, solves) in enumerate(spent.tolist())
        ]

    def _nearer(self, c: Array, end: End) -> End | None:
        """Return the end at its new level where that needs no other solve, else None."""
        if end.to_limit is not None:
            return end if end.to_limit <= end.rise else None
        if abs(end.rise - end.solved) <= _SETTLED * end.solved:
            return end
        if end.moved is None or end.rise > end.solved:
            return None
        # Inside of all constraints extremes lie on a line through the estimate.
        square, product = float(end.moved @ end.moved), float(end.moved @ self.residual)
        share = min((np.sqrt(product**2 + square * end.rise) - product) / square, 1.0)
        theta = self.theta + share * (end.theta - self.theta)
        if float(c @ theta) - self.proven(c, end) > _TIGHT * float(c @ (self.theta - theta)):
            return None
        return replace(end, theta=theta, solved=end.rise)

    def _at(self, c: Array, rise: float) -> End:
        """Return the minimum at a level, and what the fit loses there."""
        slope = self.program.coordinates.directions.T @ c
        size = float(np.linalg.norm(slope)) or 1.0
        slope, radius = slope / size, self._radius(rise) / self.unit

        def judge(
            _: Array, solution: ConicSolution
        ) -> tuple[tuple[End, ConicSolution], float] | None:
            if len(solution.ball) == 0:
                return None
            end = self._end(c, size, solution, rise)
            short = float(c @ end.theta) - self.proven(c, end)
            return (end, solution), short / max(abs(float(c @ (end.theta - self.theta))), 1e-12)

        # One that is not as close will do: the interval ends at the bound that it proves.
        best = solve_with_retries(
            partial(self.family.solve, slope, radius),
            _REGULARIZATIONS,
            judge,
            enough=_CLOSE,
        )
        if best.value is None:
            raise SolverError(
                f"profile intervals: the solver found no extreme ({best.status}); use "
                "method='gauss_markov' or 'bootstrap'.",
                problem=self.problem,
            )
        end, found = best.value
        moved = self.problem.squared.residual(end.theta) - self.residual
        end = replace(end, seconds=best.seconds, solves=best.solves, moved=moved)
        pull, x = float(found.ball[0]), np.asarray(found.x)
        value = float(slope @ x)
        if not np.any(slope):
            return end
        if pull * radius > _FLAT * abs(value):
            # The multiplier of the radius, per unit of the squares.
            weight = 2.0 * radius / pull
            there = self.response.at(x, found.rows, found.blocks, weight=weight, held=slope)
            return replace(end, lost=self._free - there)
        # The data have no say at this level: what do they say of parameters at that limit?
        conic, stiff = self.program.conic, self.response.stiff
        squares = np.vstack([conic.M, stiff * slope]), np.append(conic.m, -stiff * value)
        held = self.held.solve(squares=squares)
        end = replace(end, seconds=end.seconds + held.seconds, solves=end.solves + 1)
        if held.x is None:
            return end
        there = self.response.at(held.x, held.rows, held.blocks, held=slope)
        moved = self.problem.squared.residual(self.program.theta(held)) - self.residual
        to_limit = float(moved @ moved + 2.0 * moved @ self.residual)
        return replace(end, moved=moved, lost=self._free - there, to_limit=to_limit)

    def _radius(self, rise: float) -> float:
        return float(np.sqrt(self.cost + rise))

    def _end(self, c: Array, size: float, solution: ConicSolution, rise: float) -> End:
        """Return the end that a solution gives."""
        problem, feasible, program = self.problem, self.problem.feasible, self.program
        theta = program.theta(solution)
        found = program.multipliers(solution, theta)
        share = size / self.unit**2
        u = solution.ball[1:] * size / self.unit
        rows = share * found.rows
        limits = np.where(rows > 0.0, feasible.row_lower, feasible.row_upper)
        rows = np.where(np.isfinite(limits), rows, 0.0)
        Z = clip_psd(share * found.Z)
        if np.any(feasible.equations):
            left = self._left(c, u, Z, np.where(feasible.equations, 0.0, rows))
            rows[feasible.equations] = program.of_equations(left - share * found.bounds)
        width = max(abs(float(c @ (theta - self.theta))), 1e-300)
        # What an end would move by, were all limits that theta is at twice as far.
        limit = np.maximum(np.abs(feasible.lower), np.abs(feasible.upper))
        held = share * np.abs(np.nan_to_num(found.bounds)) * limit
        held = np.where(np.abs(theta) >= _AT * limit, held, 0.0)
        mass = feasible.bounded & (np.arange(len(theta)) < 10 * feasible.n_links)
        wide, heavy = (float(np.sum(held[each])) for each in (~feasible.bounded, mass))
        # Multipliers that hold next to nothing have no source.
        counts, of_prior = (
            float(np.linalg.norm(u)) * self.unit > _RESTS * width,
            u[len(problem.A) :],
        )
        return End(
            theta=theta,
            u=u,
            Z=Z,
            rows=rows,
            rise=rise,
            solved=rise,
            rests=(wide >= _RESTS * width, heavy >= _RESTS * width),
            prior_share=float(of_prior @ of_prior) / float(u @ u) if counts else 0.0,
        )

    def _left(self, c: Array, u: Array, Z: Array, rows: Array) -> Array:
        """Return c less what the multipliers account for, (p,): zero but for rounding."""
        feasible = self.problem.feasible
        return np.asarray(
            c - self.problem.squared.transposed(u) - feasible.adjoint(Z) - rows @ feasible.rows
        )

    def proven(
        self,
        c: Array,
        end: End,
        box: tuple[Array, Array] | None = None,
        rise: float | None = None,
    ) -> float:
        """Return the lower bound on c·theta that the multipliers prove at a level.

        Parameters
        ----------
        c : ndarray, shape (p,)
            The function.
        end : End
            Multipliers.
        box : tuple of ndarray, optional
            Lower and upper bounds of theta that hold at this level; by default those declared.
        rise : float, optional
            The level; by default the end's.
        """
        feasible = self.problem.feasible
        lower, upper = box or (feasible.lower, feasible.upper)
        left = self._left(c, end.u, end.Z, end.rows)
        radius = self._radius(end.rise if rise is None else rise)
        limits = np.where(end.rows > 0.0, feasible.row_lower, feasible.row_upper)
        limits = np.where(end.rows == 0.0, 0.0, limits)
        value = float(end.u @ self.problem.squared.rhs) - float(np.linalg.norm(end.u)) * radius
        value -= float(np.einsum("nij,nij->", end.Z, feasible.block_constants))
        value += float(end.rows @ limits)
        return value + float(left @ np.where(left > 0.0, lower, upper))

    def box(self, functions: Array, ends: Sequence[End]) -> tuple[Array, Array]:
        """Return bounds of theta that hold at every level used, from the multipliers found."""
        lower, upper = self.problem.feasible.lower.copy(), self.problem.feasible.upper.copy()
        highest = max((max(end.rise, end.solved) for end in ends), default=0.0)
        for c, end in zip(functions, ends, strict=True):
            index = np.flatnonzero(c)
            if len(index) == 1 and abs(c[index[0]]) == 1.0:
                k, bound = index[0], self.proven(c, end, rise=highest)
                if c[k] > 0.0:
                    lower[k] = max(lower[k], bound)
                else:
                    upper[k] = min(upper[k], -bound)
        return lower, upper


def profile_intervals(
    estimate: Estimate, wanted: ParameterFunctions, level: float, groups: Groups, n_jobs: int | None
) -> dict[str, Any]:
    """Return the extremes over all feasible parameters within the level, as fields of intervals."""
    if estimate.theta is None:
        raise DataError(
            f"intervals: method '{estimate.method}' gives no standard parameters; use "
            "method='gauss_markov', or an estimate of a constrained solver."
        )
    errors, signs = fit_errors(estimate, groups), np.array([1.0, -1.0])
    profile = ProfileLikelihood(estimate.problem, np.array(estimate.theta), errors, level)
    functions = np.repeat(wanted.functions, 2, axis=0)
    functions[1::2] *= -1.0
    moves = [
        profile.expected(each) if seen else None
        for each, seen in zip(wanted.functionals, wanted.determined, strict=True)
        for _ in signs
    ]
    ends = profile.minima(functions, moves, n_jobs)
    box = profile.box(functions, ends)
    pairs = list(zip(functions, ends, strict=True))
    proven = np.reshape([profile.proven(c, end, box) for c, end in pairs], (-1, 2)) * signs
    slack = [float(c @ end.theta) - profile.proven(c, end, box, end.solved) for c, end in pairs]
    rests = np.array([end.rests for end in ends], dtype=bool).reshape(-1, 2, 2)
    shares = np.array([end.prior_share for end in ends]).reshape(-1, 2)
    by_prior = (shares > 0.5) | rests[:, :, 0]
    return {
        "lower": frozen(proven[:, 0]),
        "upper": frozen(proven[:, 1]),
        "label": tuple(
            FROM_DATA if seen else FROM_PRIOR if held else FROM_PHYSICS
            for seen, held in zip(wanted.determined, by_prior.any(axis=1), strict=True)
        ),
        "by_mass": rests[:, :, 1],
        "slack": frozen(np.reshape(slack, (-1, 2))),
        "seconds": sum(end.seconds for end in ends),
        "solves": sum(end.solves for end in ends),
    }
