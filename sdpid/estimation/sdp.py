"""The global optimum, as a semidefinite program in CVXPY, solved by Clarabel."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._arrays import Array, Indices, Mask, frozen
from sdpid.errors import InfeasibleError, SolverError
from sdpid.estimation.bound import Bound, cost_scale, lower_bound, relative_gap
from sdpid.estimation.estimate import FEASIBLE, Estimate, Multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp_face import nearest_on_face
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import Consistency

# What is taken to be inside: a solution on the boundary is moved in by this share of the link's
# own second moments, so that rounding cannot take it out again. It is some fifty roundings and no
# more: moments that the data do not show may be as large as theta_max, and what is added to them
# is added to those that the data do show.
_INSIDE = 1e-14

# Rounding of what was added may take a second look, seldom a third.
_REPAIRS = 10

# Tighter than the solver can reach: it then stops where it makes no further progress, and what
# it found is judged by the gap that is recomputed here. Each attempt starts with new scales.
_TOLERANCE = 1e-11

# What Clarabel adds to the diagonal of its linear systems. Its default of 1e-8 suits the 6×6
# inequality, whose ten parameters spread over 21 entries; for the 4×4 it is too much where the
# data are precise and the cost steep: the solver then stops 1e-3 above the optimum.
_DEGENERATE, _STEEP, _BETWEEN = 1e-8, 1e-12, 1e-10

# Weight of ‖z‖² in some attempts, beside a cost of order one: where the optimal face is unbounded
# but for theta_max, it keeps the path of the solver from running off along it. What that costs
# is part of the gap, which decides.
_ANCHOR = 1e-10

# In some attempts bodies are no larger than this many lengths of the robot. Where far larger ones
# would fit no better, or hardly, the solver is spared the way to theta_max; a proof covers
# everything up to theta_max all the same.
_NEAR = 1.0

# Where nothing was found the cost is counted in units larger by this factor.
_COARSER = 1e3

# Choosing among the optimal points may cost this share of the cost.
_FACE = 1e-7

# A proven lower bound further than this below the cost is not an optimum.
_GAP = 1e-6


def solve_sdp(problem: Problem, *, verbose: bool = False) -> Estimate:
    """Minimise the cost over all consistent parameters: the global optimum.

    The parameters are measured from a point that fits the data best, in units in which they are
    of order one. The result is recomputed: it is moved inside every constraint, and its
    multipliers are kept for `sdpid.certify`. Of all optimal parameters, which differ in
    directions that the effort does not show, those nearest to the robot's description are
    returned (see `sdpid.estimation.sdp_face`).

    Parameters
    ----------
    problem : Problem
        The problem.
    verbose : bool, optional
        Let the solver print.

    Returns
    -------
    Estimate
        With status ``"optimal"``.

    Raises
    ------
    InfeasibleError
        When no parameters satisfy the constraints.
    SolverError
        When the solver ends without an optimum; the last point found is attached.
    """
    try:
        problem.feasible.require_feasible()
    except InfeasibleError as error:
        error.problem = problem
        raise
    scaling = Scaling.of(problem)
    found_scaling = scaling
    reference = _reference(problem, scaling)
    boxed = problem.feasible.bounded
    solve_time, iterations, status = 0.0, 0, ""
    best: Estimate | None = None
    bound: Bound | None = None
    best_gap = np.inf
    for attempt in _attempts(problem.consistency):
        chosen = found_scaling if attempt.around else scaling
        program = _Program.build(problem, chosen, reference, boxed, attempt)
        status = program.run(attempt.regularisation, verbose)
        solve_time += program.solve_time
        iterations += program.iterations
        if program.z.value is None:
            # Also where Clarabel says infeasible: the constraints were found to hold together.
            if best is None:
                scaling = replace(scaling, cost=_COARSER * scaling.cost)
                found_scaling = replace(found_scaling, cost=scaling.cost)
            continue
        theta = program.theta()
        outside = (theta < problem.feasible.lower) | (theta > problem.feasible.upper)
        if np.any(outside & ~boxed):
            # theta_max matters after all: give the solver the bounds that it overstepped.
            boxed = boxed | outside
            continue
        estimate = Estimate.of_theta(
            problem,
            repair(problem, theta),
            method="sdp",
            status="optimal",
            message=f"Clarabel: {status}",
            iterations=iterations,
            solve_time=solve_time,
            multipliers=program.multipliers(),
        )
        proven = lower_bound(estimate)
        # The cheapest point and the strongest proof may come from different attempts.
        if best is None or estimate.cost < best.cost:
            best = estimate
        if bound is None or proven.value > bound.value:
            bound = proven
        best_gap = relative_gap(problem, best.cost, bound.value)
        if best_gap <= _GAP:
            break
        # From now on count the cost in units of itself.
        scaling = replace(scaling, cost=max(scaling.cost, best.cost))
        found_scaling = scaling.around(np.array(best.theta))
    if best is not None and best.multipliers is not None and bound is not None:
        proof = replace(best.multipliers, Z=bound.Z, y=bound.y)
        best = replace(best, multipliers=proof, iterations=iterations, solve_time=solve_time)
    if best is None or best_gap > _GAP or (best.violation or 0.0) > FEASIBLE:
        found = "nothing" if best is None else f"a relative gap of {best_gap:.1e}"
        raise SolverError(
            f"SDP of '{problem.robot.name}': Clarabel ended '{status}' with {found} "
            f"(limit {_GAP:.0e}); check the excitation (problem.excitation) and the margin.",
            problem=problem,
            found=best,
        )
    return _settled(best)


@dataclass(frozen=True)
class _Attempt:
    """How one attempt is made.

    Attributes
    ----------
    regularisation : float
        Clarabel's.
    around : bool
        Whether links are counted in units of what the attempt before found.
    anchor : float
        Weight of ‖z‖².
    reach : float or None
        Largest size of bodies, in lengths of the robot.
    """

    regularisation: float
    around: bool = False
    anchor: float = 0.0
    reach: float | None = None


def _attempts(consistency: Consistency) -> tuple[_Attempt, ...]:
    """Return what is tried in turn until the gap is proven small, the likeliest first."""
    if consistency == "spatial_inertia":
        order = ((_DEGENERATE, False), (_STEEP, False), (_DEGENERATE, True), (_STEEP, True))
    else:
        order = ((_STEEP, False), (_STEEP, True), (_DEGENERATE, True), (_DEGENERATE, False))
    plain = [*(_Attempt(*pair) for pair in order), _Attempt(_BETWEEN, True), _Attempt(_BETWEEN)]
    near = [_Attempt(order[0][0], reach=_NEAR), _Attempt(_BETWEEN, True, reach=_NEAR)]
    anchored = [_Attempt(value, anchor=_ANCHOR) for value in (_DEGENERATE, _STEEP, _BETWEEN)]
    return (*plain[:2], *near, *plain[2:], *anchored)


def _settled(estimate: Estimate) -> Estimate:
    """Move along the directions that cost nothing, to the point nearest to the description.

    What is found is kept only where it costs no more than the solver's own accuracy.
    """
    problem = estimate.problem
    if problem.consistency == "none" or problem.prior is not None or estimate.theta is None:
        # Without matrix inequalities nothing says what is near; with a prior nothing is free.
        return estimate
    allowed = estimate.cost + _FACE * max(estimate.cost, cost_scale(problem))
    for found in nearest_on_face(problem, np.array(estimate.theta)):
        theta = repair(problem, found)
        moved = replace(
            estimate,
            theta=frozen(theta),
            base=frozen(problem.base_of(theta)),
            message=f"{estimate.message}; nearest to the description on the optimal face",
        )
        proven = relative_gap(problem, moved.cost, lower_bound(moved).value) <= _GAP
        if moved.feasible and moved.cost <= allowed and proven:
            return moved
    return replace(estimate, message=f"{estimate.message}; any point of the optimal face")


def _reference(problem: Problem, scaling: Scaling) -> Array:
    """Return standard parameters whose base parameters fit best, smallest in scaled size."""
    basis = scaling.basis()
    if problem.prior is not None:
        G, h = problem.design
        return np.asarray(basis @ np.linalg.lstsq(G @ basis, h, rcond=None)[0])
    target = solve_wls(problem).base
    return np.asarray(basis @ np.linalg.lstsq(problem.base.matrix @ basis, target, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class _Program:
    """The CVXPY problem in z, with theta = reference + basis·z, and what Clarabel made of it."""

    problem: Problem
    scaling: Scaling
    reference: Array
    bounded: Indices
    own: Mask
    z: Any
    blocks: list[Any]
    model: Any

    @classmethod
    def build(
        cls, problem: Problem, scaling: Scaling, reference: Array, boxed: Mask, attempt: _Attempt
    ) -> _Program:
        """Build with bounds on the parameters in `boxed`, and with what the attempt adds."""
        import cvxpy as cp

        feasible = problem.feasible
        z = cp.Variable(problem.n_theta)
        basis = scaling.basis()
        unit = np.sqrt(scaling.cost)
        G = problem.design[0] @ basis / unit
        offset = problem.residual_of(reference) / unit
        limit = np.where(boxed, np.inf, _largest(problem, scaling, attempt.reach))
        bounded = np.flatnonzero(boxed | np.isfinite(limit))
        size = scaling.theta[bounded]
        rows = basis[bounded] / size[:, None]
        constraints: list[Any] = [
            rows @ z >= (np.maximum(feasible.lower, -limit) - reference)[bounded] / size,
            rows @ z <= (np.minimum(feasible.upper, limit) - reference)[bounded] / size,
        ]
        blocks: list[Any] = []
        if feasible.consistency != "none":
            s = feasible.size
            inverses = np.linalg.inv(scaling.roots(s))
            constant = inverses @ feasible.matrices(reference) @ np.swapaxes(inverses, 1, 2)
            for link, inverse in enumerate(inverses):
                own = slice(10 * link, 10 * link + 10)
                matrices = np.einsum("ka,kij->aij", basis[own, own], feasible.basis())
                linear = (inverse @ matrices @ inverse.T).reshape(10, -1)
                F = cp.reshape(linear.T @ z[own], (s, s), order="C") + constant[link]
                blocks.append(F >> 0)
        cost = cp.sum_squares(G @ z + offset)
        if attempt.anchor > 0.0:
            cost = cost + attempt.anchor * cp.sum_squares(z)
        objective = cp.Minimize(cost)
        model = cp.Problem(objective, constraints + blocks)
        return cls(problem, scaling, reference, bounded, boxed, z, blocks, model)

    def run(self, regularisation: float, verbose: bool) -> str:
        """Solve and return the status."""
        import cvxpy as cp

        settings = {
            "tol_gap_abs": _TOLERANCE,
            "tol_gap_rel": _TOLERANCE,
            "tol_feas": _TOLERANCE,
            "static_regularization_constant": regularisation,
        }
        try:
            with warnings.catch_warnings():
                # The warning that the solution may be inaccurate: its gap is recomputed.
                warnings.simplefilter("ignore")
                self.model.solve(
                    solver=cp.CLARABEL, verbose=verbose, accept_unknown=True, **settings
                )
        except cp.error.SolverError as cause:
            return f"failed ({cause})"
        return str(self.model.status)

    @property
    def solve_time(self) -> float:
        """Seconds in Clarabel."""
        return float(getattr(self.model.solver_stats, "solve_time", None) or 0.0)

    @property
    def iterations(self) -> int:
        """Iterations of Clarabel."""
        return int(getattr(self.model.solver_stats, "num_iters", None) or 0)

    def theta(self) -> Array:
        """Return the standard parameters found."""
        return np.asarray(self.reference + self.scaling.basis() @ self.z.value)

    def multipliers(self) -> Multipliers:
        """Return the multipliers in units of the cost."""
        scaling = self.scaling
        bounds = np.full(self.problem.n_theta, np.nan)
        lower, upper = self.model.constraints[:2]
        bounds[self.bounded] = scaling.cost * (
            (lower.dual_value - upper.dual_value) / scaling.theta[self.bounded]
        )
        # Bounds that only an attempt has are none of the problem's.
        bounds[~self.own] = np.nan
        s = self.problem.feasible.size
        if not self.blocks:
            return Multipliers(np.zeros((0, s, s)), frozen(bounds))
        duals = np.stack([block.dual_value for block in self.blocks])
        duals = 0.5 * (duals + np.swapaxes(duals, 1, 2))
        inverses = np.linalg.inv(scaling.roots(s))
        Z = scaling.cost * np.swapaxes(inverses, 1, 2) @ duals @ inverses
        return Multipliers(frozen(Z), frozen(bounds))


def _largest(problem: Problem, scaling: Scaling, reach: float | None) -> Array:
    """Return the largest standard parameters of bodies of so many lengths, infinite if None."""
    out = np.full(problem.n_theta, np.inf)
    if reach is not None:
        far = reach * scaling.length
        units = np.array([1.0, *(far,) * 3, *(far**2,) * 6])
        out[: scaling.bodies.size] = np.tile(
            problem.constraints.mass_max * units, len(scaling.bodies)
        )
    return out


def repair(problem: Problem, theta: Array) -> Array:
    """Move parameters that are outside by rounding just inside every constraint.

    Bounds are clipped; a link short of its margin gets the missing second moment in all
    directions, which raises its margin by exactly that and changes nothing else.
    """
    feasible = problem.feasible
    theta = np.clip(theta, feasible.lower, feasible.upper)
    if feasible.consistency == "none":
        return theta
    out = theta.copy()
    bodies = out[: 10 * feasible.n_links].reshape(-1, 10)
    # A second moment t·E about the centre of mass is an inertia of 2·t·E.
    factor = 2.0 if feasible.consistency == "pseudo_inertia" else 1.0
    for step in range(_REPAIRS):
        moments = np.maximum(bodies[:, 4] + bodies[:, 6] + bodies[:, 9], 1e-3)
        lacks = feasible.constraints.margin - feasible.margins(out)
        short = lacks + 2.0**step * _INSIDE * moments
        # First every link that is near the boundary, then those that rounding left outside.
        short = np.where((lacks > 0.0) | (step == 0), np.maximum(short, 0.0), 0.0)
        if not short.any():
            break
        bodies[:, [4, 6, 9]] += factor * short[:, None]
    return out
